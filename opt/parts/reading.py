"""What parts answer, read for the solvers: formulas become residuals, and errors name the part."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError, FfsmsWarning, PartError
from ffsms_pin.opt.limits.limit import Rows, Violation
from ffsms_pin.opt.motion.feature import Feature, lost_slopes
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.nudged import by_differences
from ffsms_pin.opt.motion.residual import JointResidual, Residual, Residuals
from ffsms_pin.opt.step.state import StepState

__all__ = ["Formula", "asked", "formulas", "residuals_of", "rows_of", "violation_of"]

# What a part's formula may be.
Formula: TypeAlias = "Feature | Residual | JointResidual | FloatArray | Sequence[Formula]"

_differenced: set[tuple[type, str]] = set()  # parts that were said to be slow


def residuals_of(part: Any, motions: Motions | Features) -> Residuals:
    """Residuals of a term or a limit at motions; features are theirs, which several parts can share.

    Raises
    ------
    PartError
        `part.residual` fails, or gives something that is no residual; the text names part and shapes.
    """
    found: Residuals = []
    seen = motions if isinstance(motions, Features) else Features(motions)
    for one in formulas(part, "residual", seen):
        found.extend([one] if isinstance(one, (Residual, JointResidual)) else one.residuals())
    return found


def rows_of(limit: Any, step: StepState) -> Rows | None:
    """Rows of a limit in a step; a `PartError` where they fail or have wrong shapes."""
    rows = asked(limit, "rows", step)
    if rows is None:
        return None
    if not isinstance(rows, Rows):
        raise PartError(limit, "rows", f"must return opt.Rows or None; got {type(rows).__name__}")
    k, n = len(rows.lower), len(step.rates)
    shapes = np.shape(rows.G), np.shape(rows.lower), np.shape(rows.upper)
    if shapes != ((k, n), (k,), (k,)):
        raise PartError(limit, "rows", f"must give G (k, {n}), lower (k,) and upper (k,); got {shapes}")
    return rows


def violation_of(limit: Any, motion: Motions) -> Violation:
    """What a finished motion makes of a limit; a `PartError` where it fails or says something else."""
    found = asked(limit, "violation", motion)
    if not isinstance(found, Violation):
        raise PartError(limit, "violation", f"must return an opt.Violation; got {type(found).__name__}")
    return found


def formulas(part: Any, method: str, features: Features) -> list[Feature | Residual | JointResidual]:
    """What a method of a part gives for these features, flat and checked; differenced without slopes."""
    return [_read(part, method, i, one, features) for i, one in enumerate(_answers(part, method, features))]


def asked(part: Any, method: str, *arguments: Any) -> Any:
    """What a method of a part gives; an error in it becomes one that names part and method."""
    try:
        return getattr(part, method)(*arguments)
    except FfsmsError:
        raise
    except Exception as error:
        raise PartError(part, method, f"failed with {type(error).__name__}: {error}") from error


def _answers(part: Any, method: str, features: Features) -> list[Any]:
    before = lost_slopes()
    found = _flat(asked(part, method, features))
    if lost_slopes() > before:  # a feature was made a plain array on the way: its slopes are not all there
        found = [one.value if isinstance(one, Feature) else one for one in found]
    return found


def _flat(found: Any) -> list[Any]:
    if isinstance(found, (list, tuple)):
        return [one for each in found for one in _flat(each)]
    return [found]


def _read(part: Any, method: str, i: int, found: Any, features: Features) -> Any:
    if isinstance(found, (Residual, JointResidual)):
        found = _plain(found)
        _check_residual(part, method, found, features)
        return found
    if isinstance(found, Feature):
        if found.where is None:
            _check_shape(part, method, found.value, features)
        return found
    if isinstance(found, (np.ndarray, float, int)):
        value = np.asarray(found, dtype=np.float64)
        _check_shape(part, method, value, features)
        return _differenced_answer(part, method, i, value, features)
    raise PartError(
        part,
        method,
        f"must return a Feature, a Residual, an array (S, K), or a list of these; got {type(found).__name__}",
    )


def _check_shape(part: Any, method: str, value: FloatArray, features: Features) -> None:
    wanted = features.motions.rates.shape[1:]
    if value.shape[-2:] != wanted or value.ndim > 3:
        raise PartError(
            part,
            method,
            f"must return shape (S, K) = {wanted} or (c, S, K) = (c, {wanted[0]}, {wanted[1]}); "
            f"got {value.shape}",
        )


def _check_residual(part: Any, method: str, found: Residual | JointResidual, features: Features) -> None:
    """Values and slopes have the shapes that go together."""
    S, K = features.motions.rates.shape[1:]
    value, n = found.value, features.motions.stack.n
    if isinstance(found, JointResidual):
        if value.shape != (n, S, K):
            raise PartError(part, method, f"must give a value of shape {(n, S, K)}; got {value.shape}")
        return
    if found.motion is not None:
        wanted: tuple[int, ...] = found.motion.shape
    else:
        wanted = (S, len(np.arange(K)[found.instants]))
    if value.shape != wanted:
        raise PartError(part, method, f"must give a value of shape {wanted}; got {value.shape}")
    heads = {"by_entropy": (), "by_coupling": (6, n)}
    for name, slope in found.slopes().items():
        moved = heads.get(name, (n,) if name in _JOINTS else (3,))
        if slope.ndim != len(moved) + len(wanted) or any(
            have not in (1, want) for have, want in zip(slope.shape, (*moved, *wanted), strict=True)
        ):
            raise PartError(part, method, f"must give {name} of shape {(*moved, *wanted)}; got {slope.shape}")


_JOINTS = ("by_joints", "by_rates", "by_accelerations")


def _plain(found: Residual | JointResidual) -> Residual | JointResidual:
    """With plain arrays where features stand."""
    for name, value in vars(found).items():
        if isinstance(value, Feature):
            object.__setattr__(found, name, value.value)
    return found


def _differenced_answer(part: Any, method: str, i: int, value: FloatArray, features: Features) -> Feature:
    """Answer i of a part, with slopes by differences; once for each part it says that this is slow."""
    if (type(part), method) not in _differenced:
        _differenced.add((type(part), method))
        warnings.warn(
            f"{type(part).__name__}.{method} gives values without slopes: differences take their place, "
            "which is slow; write it with features (m.tip, m.frame(...), m.rates, ...)",
            FfsmsWarning,
            stacklevel=2,
        )

    def values(motions: Motions) -> FloatArray:
        seen = Features(motions, features.duration, features.where)
        one = _answers(part, method, seen)[i]
        return np.asarray(one.value if isinstance(one, Feature) else one, dtype=np.float64)

    return Feature(value, lambda: by_differences(values, features.motions), features.where)
