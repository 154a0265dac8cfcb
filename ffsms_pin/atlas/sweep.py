"""A sweep over designs: what an atlas would say of each, in a few numbers, and which designs are best."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.atlas.build import digest
from ffsms_pin.atlas.designs import Design
from ffsms_pin.atlas.measures import SCALARS, Sampling, measured, wheel_momentum_per_speed
from ffsms_pin.checks import MOST_STEPS, FloatArray, instance, number, one_of, positive, whole
from ffsms_pin.engine import Chunks, Shard, joined, run
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.version import __version__

# Of each design, over its samples.
STATISTICS = {
    "reach": "largest distance of the end effector from the base's centre of mass [m]",
    "base_translation": "base translation per metre of the end effector, median [m/m]",
    "base_translation_90": "base translation that 90 % of the samples stay below [m/m]",
    "base_rotation": "base rotation per metre of the end effector, median [rad/m]",
    "base_rotation_90": "base rotation that 90 % of the samples stay below [rad/m]",
    "entropy": "entropy of the coupling, median [-]",
    "manipulability": "manipulability of J*, median [-]",
}
# Besides, of a robot with reaction wheels.
OF_WHEELS = {
    "wheel_momentum": "momentum of the fullest wheel at 1 m/s of the end effector, base not turning [N m s]"
}
_MOUNT = ("mount_x", "mount_y", "mount_z")
_LINK = "link:"
MOST_DESIGNS = 1_000_000


@dataclass(frozen=True, eq=False)
class Sweep:
    """Designs and what was found of each.

    Attributes
    ----------
    parameters : dict of str to ndarray, shape (D,)
        By name, as `sweep` takes them.
    statistics : dict of str to ndarray, shape (D,)
        See `STATISTICS`, and `OF_WHEELS` where the robot has reaction wheels.
    """

    parameters: Mapping[str, FloatArray]
    statistics: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(self.statistics["reach"])

    def best(self, motion: str = "base_rotation") -> NDArray[np.bool_]:
        """Designs (D,) that no other one beats both in reach and in a statistic that should be small."""
        small = self.statistics[one_of("motion", motion, self.statistics)]
        return pareto(self.statistics["reach"], small)


@dataclass(frozen=True)
class SweepWork:
    """The table of a range of designs, for `ffsms_pin.engine.run`."""

    sms: SpaceManipulator
    axes: tuple[tuple[str, tuple[float, ...]], ...]
    sampling: Sampling

    def designs(self) -> list[tuple[float, ...]]:
        """Values of the parameters of every design, the last parameter fastest."""
        return list(itertools.product(*(values for _, values in self.axes)))

    def __call__(self, rows: range) -> dict[str, FloatArray]:
        """Parameters and statistics of these designs."""
        designs, found = self.designs(), []
        for row in rows:
            values = dict(zip((name for name, _ in self.axes), designs[row], strict=True))
            found.append(values | _statistics(_design(values).applied(self.sms), self.sampling))
        return {name: np.array([one[name] for one in found]) for name in found[0]}


def sweep(
    sms: SpaceManipulator,
    parameters: Mapping[str, Sequence[float]],
    folder: str | os.PathLike[str],
    samples: int = 16384,
    *,
    seed: int = 0,
    jobs: int | None = None,
    scheduler: str | None = None,
    shard: Shard | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep | None:
    """Measure every combination of some design parameters.

    Parameters
    ----------
    sms : SpaceManipulator
        Which the parameters change; see `Design`.
    parameters : mapping of str to sequence of float
        "base_mass" and "base_inertia" are factors of the robot's own; "mount_x", "mount_y", "mount_z" are
        shifts of the mount point [m]; "link:NAME" is a factor of the length of the link behind joint NAME.
    folder : path
        For what is done; a sweep that was killed goes on from there.
    samples : int
        Configurations of each design: the same joint positions for all.
    seed : int
    jobs, scheduler, shard, progress
        See `ffsms_pin.engine.run`.

    Returns
    -------
    Sweep or None
        None for a shard.

    Raises
    ------
    InvalidValue
        A parameter that is not known, or values that no design can have.
    ResultError, ClusterError
    """
    instance("sms", sms, SpaceManipulator)
    whole("samples", samples, 1, MOST_STEPS)  # those of a design are kept
    work = SweepWork(sms, _axes(sms, parameters), Sampling.of(sms, samples, seed=seed))
    specification = {
        "what": "sweep",
        "model": sms.model.name,
        "robot_sha256": digest(sms),
        "parameters": {name: list(values) for name, values in work.axes},
        "wheel_axes": [] if sms.wheels is None else sms.wheels.axes.tolist(),
        "sampling": asdict(work.sampling),
        "version": __version__,
    }
    place = run(
        work,
        Chunks(len(work.designs()), 8),
        folder,
        specification=specification,
        jobs=jobs,
        scheduler=scheduler,
        shard=shard,
        progress=progress,
    )
    if shard is not None:
        return None
    columns = joined(list(place.tables()))
    axes = {name: columns[name] for name, _ in work.axes}
    return Sweep(axes, {name: columns[name] for name in names_of(sms)})


def names_of(sms: SpaceManipulator) -> list[str]:
    """Names of the statistics of a robot's designs."""
    return [*STATISTICS, *(() if sms.wheels is None else OF_WHEELS)]


def pareto(large: FloatArray, small: FloatArray) -> NDArray[np.bool_]:
    """Which points (D,) no other one beats.

    One point beats another where it has at least as much of `large` and at most as much of `small`, and is
    better in one of the two. Equal points do not beat each other.
    """
    best = np.zeros(len(large), dtype=bool)
    least, last = np.inf, (np.nan, np.nan)
    for i in np.lexsort((small, -large)):  # the largest first, and of equals the smallest
        point = (float(large[i]), float(small[i]))
        if point[1] < least or point == last:
            best[i], least, last = True, point[1], point
    return best


def _axes(
    sms: SpaceManipulator, parameters: Mapping[str, Sequence[float]]
) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """The parameters as plain numbers, checked."""
    links = [f"{_LINK}{joint}" for joint in sms.joint_names]
    known = ["base_mass", "base_inertia", *_MOUNT, *links]
    instance("parameters", parameters, Mapping)
    axes, count = [], 1
    for name, values in parameters.items():
        if name not in known:
            raise InvalidValue("parameters", name, f"must be one of {', '.join(known)}")
        instance(name, values, (Sequence, np.ndarray))
        check = number if name in _MOUNT else positive
        axes.append((name, tuple(check(name, value) for value in values)))
        count *= len(values)
        if not len(values) or count > MOST_DESIGNS:
            raise InvalidValue(name, values, f"must make between 1 and {MOST_DESIGNS} designs")
        if name in links:  # a link without length is found out before the work
            _design({name: axes[-1][1][0]}).applied(sms)
    if not axes:
        raise InvalidValue("parameters", parameters, f"must name at least one of {', '.join(known)}")
    return tuple(axes)


def _design(values: Mapping[str, float]) -> Design:
    x, y, z = (values.get(name, 0.0) for name in _MOUNT)
    links = {name[len(_LINK) :]: value for name, value in values.items() if name.startswith(_LINK)}
    return Design(values.get("base_mass", 1.0), values.get("base_inertia", 1.0), (x, y, z), links)


def _statistics(sms: SpaceManipulator, sampling: Sampling) -> dict[str, float]:
    joints = sampling.joints(range(sampling.rows))
    found = measured(sms, joints)
    values = {name: np.median(found[name]) for name in SCALARS}
    values |= {f"{name}_90": np.quantile(found[name], 0.9) for name in ("base_translation", "base_rotation")}
    values["reach"] = np.linalg.norm(found["end_effector"], axis=1).max()
    if sms.wheels is not None:
        values["wheel_momentum"] = np.median(wheel_momentum_per_speed(sms, joints))
    return {name: float(values[name]) for name in names_of(sms)}
