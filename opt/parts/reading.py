"""What parts answer, read for the solvers: formulas, or slopes by hand; errors name the part."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray, reals
from ffsms_pin.errors import FfsmsWarning, InvalidValue, PartError
from ffsms_pin.opt.limits.limit import Rows, Violation
from ffsms_pin.opt.motion.feature import OWN, Feature, Indices, watched
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import MOVED, Motions, by_differences

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

# What a part's formula may be.
Formula: TypeAlias = "Feature | FloatArray | Sequence[Formula]"


class Residual(Feature):
    """A number at instants of motions, and its slopes, in inertial axes; what is left out does not matter.

    Dense, with values at K instants of each of S motions; or, where most are zero, only V entries of them:
    then `motion` says of which motions they are, `instants` at which instants, and (S, K) below reads (V,).

    Parameters
    ----------
    value : ndarray, shape (S, K)
    instants : ndarray of int, shape (K,), or slice
        Indices of the instants, as in `Motions.times`. Default: all.
    motion : ndarray of int, shape (V,), or None
    over_time : bool
        Whether the square is integrated over time; otherwise it counts as it is.
    by_joints, by_rates, by_accelerations : ndarray, shape (n, S, K)
        By the joint positions, rates and accelerations, whatever moves with them held still.
    by_tip, by_turn, by_velocity, by_spin : ndarray, shape (3, S, K)
        By the end effector's position, a turn of it (rotation vector), its velocity and angular velocity.
    by_base, by_base_turn, by_base_spin : ndarray, shape (3, S, K)
        By the position of the base's centre of mass, a turn of the base, and its angular velocity.
    by_entropy : ndarray, shape (S, K)
        By H_norm.
    by_coupling : ndarray, shape (6, n, S, K)
        By the entries of C_bm in base axes (`ArmValues.coupling`).
    """

    def __init__(
        self,
        value: Any,
        instants: Indices | slice = slice(None),
        motion: Indices | None = None,
        over_time: bool = True,
        **slopes: Any,
    ) -> None:
        value, slopes = _plain("value", value), {name: _plain(name, slope) for name, slope in slopes.items()}
        if motion is not None:
            value = value[None]
            slopes = {name: np.atleast_1d(slope)[..., None, :] for name, slope in slopes.items()}
        super().__init__(value, slopes, (motion, instants), over_time)


class JointResidual(Feature):
    """A number a joint at every instant that depends on that joint alone; integrated over time.

    Parameters
    ----------
    value : ndarray, shape (n, S, K)
    by_position, by_rate, by_acceleration : ndarray, shape (n, S, K) or broadcastable
        By the joint's own position, rate and acceleration.
    """

    def __init__(
        self, value: Any, by_position: Any = None, by_rate: Any = None, by_acceleration: Any = None
    ) -> None:
        by = zip(OWN, (by_position, by_rate, by_acceleration), strict=True)
        slopes = {name: _plain("slope", slope) for name, slope in by if slope is not None}
        super().__init__(_plain("value", value), slopes, (None, slice(None)))


_BY_HAND = (Residual, JointResidual)
# What methods must return, in words.
_KINDS: dict[str, tuple[Any, str]] = {
    "rows": ((Rows, type(None)), "opt.Rows or None"),
    "step_objective": ((tuple, type(None)), "a matrix and a vector, or None"),
    "violation": (Violation, "an opt.Violation"),
    "share": ((int, float, np.number), "a number"),
}


def checked_parts(name: str, parts: Any, kind: type) -> tuple[Any, ...]:
    """Parts of one kind, each with a name of its own."""
    if isinstance(parts, str) or not isinstance(parts, Sequence):
        raise InvalidValue(name, parts, f"must be a sequence of opt.{kind.__name__}")
    for i, part in enumerate(parts):
        if not isinstance(part, kind):
            raise InvalidValue(f"{name}[{i}]", part, f"must be an opt.{kind.__name__}")
        if not isinstance(getattr(part, "name", None), str):
            raise InvalidValue(f"{name}[{i}]", part, "must have a `name`, a text")
    names = [part.name for part in parts]
    if twice := [one for one in names if names.count(one) > 1]:
        raise InvalidValue(name, twice[0], "must have one part of each name; give yours another `name`")
    return tuple(parts)


def residuals_of(part: Any, motions: Motions | Features) -> list[Feature]:
    """Residuals of a term or a limit at motions; features are theirs, which several parts can share."""
    seen = motions if isinstance(motions, Features) else Features(motions)
    return [one for one in formulas(part, "residual", seen) if one.value.size]


def asked(part: Any, method: str, seen: Any) -> Any:
    """What a method of a part gives; an error in it, or another kind of answer, names part and method."""
    try:
        found = getattr(part, method)(seen)
    except PartError:
        raise
    except Exception as error:
        raise PartError.of(part, method, error) from error
    kinds, wanted = _KINDS.get(method, (object, ""))
    if not isinstance(found, kinds):
        raise PartError(part, method, f"must return {wanted}; got {type(found).__name__}")
    return found


def rows_of(limit: Any, step: StepState) -> Rows | None:
    """Rows of a limit in a step, of the right shapes."""
    rows: Rows | None = asked(limit, "rows", step)
    if rows is None:
        return None
    k, n = len(rows.lower), len(step.rates)
    try:
        shapes = rows.G.shape, rows.lower.shape, rows.upper.shape
    except AttributeError:  # no arrays
        shapes = np.shape(rows.G), np.shape(rows.lower), np.shape(rows.upper)
    if shapes != ((k, n), (k,), (k,)):
        raise PartError(limit, "rows", f"must give G (k, {n}), lower (k,) and upper (k,); got {shapes}")
    return rows


def objective_of(term: Any, step: StepState) -> tuple[FloatArray, FloatArray] | None:
    """What a term adds to a step's objective, of the right shapes."""
    found: tuple[FloatArray, FloatArray] | None = asked(term, "step_objective", step)
    n = len(step.rates)
    if found is not None and [np.shape(one) for one in found] != [(n, n), (n,)]:
        raise PartError(term, "step_objective", f"must give a matrix ({n}, {n}) and a vector ({n},), or None")
    return found


def violation_of(limit: Any, motion: Motions) -> Violation:
    """What a finished motion makes of a limit."""
    found: Violation = asked(limit, "violation", motion)
    return found


def share_of(term: Any, motion: Motions) -> float:
    """What a term comes to for a finished motion."""
    try:
        return float(asked(term, "share", motion))
    except OverflowError:
        raise PartError(term, "share", "must return a number that fits into a float") from None


def formulas(part: Any, method: str, features: Features) -> list[Feature]:
    """What a method of a part gives for these features, flat and checked; differenced without slopes."""
    return [_read(part, method, i, one, features) for i, one in enumerate(_answers(part, method, features))]


def _answers(part: Any, method: str, features: Features) -> list[Any]:
    answer, slopes_lost = watched(lambda: asked(part, method, features))
    found = _flat(answer)
    if not slopes_lost:
        return found
    # Not all slopes are there, unless they are by hand.
    lost = [isinstance(one, Feature) and not isinstance(one, _BY_HAND) for one in found]
    return [one.value if plain else one for one, plain in zip(found, lost, strict=True)]


def _flat(found: Any) -> list[Any]:
    return [one for each in found for one in _flat(each)] if isinstance(found, (list, tuple)) else [found]


def _read(part: Any, method: str, i: int, found: Any, features: Features) -> Feature:
    """Answer i of a part, checked; differenced where it has no slopes."""
    if not isinstance(found, (Feature, np.ndarray, float, int)):
        wanted = "a Feature, a Residual, an array (S, K), or a list of these"
        raise PartError(part, method, f"must return {wanted}; got {type(found).__name__}")
    value: Any = found.value if isinstance(found, Feature) else found
    if getattr(value, "dtype", None) != np.float64:
        value = reals(f"{type(part).__name__}.{method}", value, "fiub")
    S, K = features.motions.rates.shape[1:]
    if getattr(found, "where", None) is None and (value.shape[-2:] != (S, K) or value.ndim > 3):
        shapes = f"{(S, K)} or (c, S, K) = (c, {S}, {K})"
        raise PartError(part, method, f"must return shape (S, K) = {shapes}; got {value.shape}")
    if not isinstance(found, Feature):
        return Feature(value, _differences(part, method, i, features), features.where)
    found.value, found.source = value, (part, method)
    return found if callable(found._slopes) else with_right_slopes(found, features.motions)


def with_right_slopes(found: Feature, motions: Motions) -> Feature:
    """A part's answer, of which values and slopes have shapes that go together."""
    if found.source is None:
        return found
    part, method = found.source
    (n, S, K), (motion, instants) = motions.rates.shape, found.where or (None, slice(None))
    try:
        count = len(np.arange(K)[instants])
        wanted = (S, count) if motion is None else (1, len(np.arange(S)[motion]))
    except IndexError as error:
        raise PartError(part, method, f"must be of instants below {K} of motions below {S}") from error
    if found.ndim == 3:
        wanted = (n if isinstance(found, JointResidual) else len(found), *wanted)
    if found.shape != wanted:
        raise PartError(part, method, f"must give a value of shape {wanted}; got {found.shape}")
    moved: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(MOVED, (3,)),
        **dict.fromkeys(OWN.values(), (n,)),
        **dict.fromkeys((*OWN, "by_entropy", "by_time"), ()),
        "by_coupling": (6, n),
    }
    for name, slope in found.slopes.items():
        if name not in moved:
            raise PartError(part, method, f"must give slopes by {', '.join(moved)}; got {name}")
        full, shape = (*wanted[:-2], *moved[name], *wanted[-2:]), np.shape(slope)
        fits = (have in (1, want) for have, want in zip(shape, full, strict=False))
        if len(shape) != len(full) or not all(fits):
            raise PartError(part, method, f"must give {name} of shape {full}; got {shape}")
    return found


def _differences(part: Any, method: str, i: int, features: Features) -> Callable[[], dict[str, FloatArray]]:
    """Makes slopes of answer i of a part; that this is slow is said where Python has not said so before."""
    warnings.warn(
        f"{type(part).__name__}.{method} gives values without slopes: differences take their place, "
        "which is slow; write it with features (m.tip, m.frame(...), m.rates, ...)",
        FfsmsWarning,
        stacklevel=2,
    )

    def values(motions: Motions) -> FloatArray:
        found = _answers(part, method, Features(motions, features.duration, features.where))
        return _plain(method, found[i])

    return lambda: by_differences(values, features.motions)


def _plain(name: str, x: Any) -> FloatArray:
    """Features may stand where arrays are asked for: their values count."""
    return x.value if isinstance(x, Feature) else reals(name, x, "fiub")
