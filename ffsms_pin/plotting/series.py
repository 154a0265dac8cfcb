"""Panels over time: quantities of joints, base and wheels, and bands of many runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ffsms_pin.analysis import base_motion
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting import style
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, PLANNED, drawing, legend_above, line
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking

_LISTED = 4  # largest number of names in the label of lines that coincide
_SAME = 0.02  # share of the largest planned value: a plan that differs by less is not drawn beside the flight
_NEAR_LIMIT = 0.1  # share of a joint's range: a limit is drawn if a position comes nearer
_STILL = 1e-6  # share of the largest wheel momentum below which a wheel is at rest
_ALIKE = 1e-3  # share of the largest wheel momentum by which wheels with a common line may differ
_UNITS = np.repeat([1e3, 180.0 / np.pi], 3)  # from [m; rad] to [mm; deg]
Motion: TypeAlias = Trajectory | Tracking


class Series(NamedTuple):
    """A series of values (k, m) at times t (k,) [s]."""

    t: FloatArray
    values: FloatArray


@drawing
def plot_series(
    ax: Axes | None,
    t: FloatArray,
    values: FloatArray,
    label: str,
    names: Sequence[str] = (),
    limits: Sequence[FloatArray] = (),
    steps: bool = False,
) -> Axes:
    """Draw values (k,) or (k, m) over t (k,) [s]; if `ax` is None, in a new figure.

    The vertical axis has the `label`, which contains the unit. The m lines have the `names`. Lines that
    coincide share an entry of the legend. Limits, each (m,), are dotted in the colour of their line, and in
    grey if several lines have the same limit; infinite limits are left out. With `steps`, a value is constant
    until the next instant instead of interpolated.
    """
    columns = np.asarray(values, dtype=np.float64)
    columns = columns.reshape(len(columns), -1) if columns.size else np.zeros((0, 1))
    ax = style.axes_or_new(ax)
    for i, name in enumerate(_labels(columns, names)):
        ax.plot(t, columns[:, i], label=name, drawstyle="steps-post" if steps else "default", **line(i))
    drawn: list[float] = []
    for limit in limits:
        for i, value in enumerate(limit):
            # A limit that several joints share is drawn once, in a neutral colour.
            shared = int(np.sum(np.isclose(limit, value))) > 1
            if np.isfinite(value) and not (shared and any(np.isclose(value, drawn))):
                drawn.append(float(value))
                ax.axhline(value, color=NEUTRAL if shared else line(i)["color"], **LIMIT)
    if drawn:
        ax.plot([], [], color=NEUTRAL, label=style.LIMITS, **LIMIT)
    style.over_time(ax, label)
    if names or drawn:
        legend_above(ax)
    return ax


def _labels(columns: FloatArray, names: Sequence[str]) -> list[str | None]:
    """Return a label for each column (k, m), None for columns without a name.

    If all columns have names, a column that coincides with an earlier column has None.
    """
    labels: list[str | None] = [names[i] if i < len(names) else None for i in range(columns.shape[1])]
    with np.errstate(invalid="ignore"):  # infinite values
        tolerance = 1e-3 * np.abs(columns[np.isfinite(columns)]).max(initial=0.0)
        differences = np.abs(columns[:, :, None] - columns[:, None, :]).max(axis=0, initial=-np.inf)
    if not len(columns) or len(names) < len(labels):
        return labels
    groups: dict[int, list[str]] = {}
    for i in range(len(labels)):
        first = next((j for j in groups if differences[i, j] <= tolerance), i)
        groups.setdefault(first, []).append(names[i])
    return [coincident(groups[i]) if i in groups else None for i in range(len(labels))]


def coincident(names: Sequence[str]) -> str:
    """Return the label of one line, or the common label of lines that coincide."""
    if len(names) == 1:
        return names[0]
    listed = ", ".join(names) if len(names) <= _LISTED else f"{names[0]} and {len(names) - 1} others"
    return f"{listed} (coincide)"


def plot_flown(
    ax: Axes | None,
    made: Sequence[Series],
    label: str,
    names: Sequence[str] = (),
    limits: Sequence[FloatArray] = (),
    steps: bool = False,
) -> Axes:
    """Draw a flown motion `made[1]`, with the plan `made[0]` thin and pale beside it if the two differ.

    Without a flown motion, or if the two agree, only the plan is drawn.
    """
    planned, *flown = made
    if not flown or not _differs(planned, flown[0]):
        return plot_series(ax, planned.t, planned.values, label, names, limits, steps)
    rows = thinned(len(flown[0].t))
    ax = plot_series(ax, flown[0].t[rows], flown[0].values[rows], label, names, limits)
    for i in range(planned.values.shape[1]):
        ax.plot(planned.t, planned.values[:, i], color=line(i)["color"], **PLANNED)
    ax.plot([], [], color=NEUTRAL, label=style.AS_PLANNED, **PLANNED)
    legend_above(ax)
    return ax


def thinned(count: int, most: int = 1500) -> NDArray[np.intp]:
    """Return the indices of at most `most` of `count` rows, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.intp))


def near_limits(
    values: FloatArray, limit: FloatArray, label: str, near: float = 0.4
) -> tuple[str, tuple[FloatArray, ...]]:
    """Return the label of values (k, m), and the lower and upper limits (m,) to draw.

    A limit is drawn if a value exceeds the share `near` of the limit, because distant limits would flatten
    the curves. All other limits are infinite. If no limit is drawn, the second result is empty and the label
    states the largest share, unless it is zero.
    """
    shares = (np.abs(values) / limit).max(axis=0, initial=0.0)
    if (shares > near).any():
        drawn = np.where(shares > near, limit, np.inf)
        return label, (-drawn, drawn)
    used = float(shares.max(initial=0.0))
    return (f"{label}\nat most {100.0 * used:.2g} % of the limits" if used > 0.0 else label), ()


def scale_decades(ax: Axes, least: float, largest: float, ratio: float, smallest: float) -> bool:
    """Set a logarithmic scale if `largest` exceeds `ratio` times `least`, and return whether it is set.

    The logarithmic axis begins at a third of `least`, or of `smallest` times `largest` if this product is
    larger than `least`, because smaller values are rounding errors.
    """
    if largest <= ratio * least:
        return False
    ax.set_yscale("log")
    ax.set_ylim(max(least, smallest * largest) / 3.0, 2.0 * largest)
    return True


def _differs(planned: Series, flown: Series) -> bool:
    """Return whether two motions differ visibly while both last."""
    both = planned.t <= flown.t[-1] + 1e-9
    interpolated = np.array([np.interp(planned.t[both], flown.t, column) for column in flown.values.T])
    difference = float(np.abs(interpolated.T - planned.values[both]).max(initial=0.0))
    return difference > max(_SAME * float(np.abs(planned.values).max(initial=0.0)), 1e-9)


@drawing
def plot_bands(
    t: FloatArray,
    runs: FloatArray,
    label: str,
    names: Sequence[str] = (),
    ax: Axes | None = None,
    share: float = 0.9,
) -> Axes:
    """Draw the median and a band of `runs` (runs, k) or (runs, k, m) over t (k,) [s].

    The m quantities have the `names`. At each instant the band contains the share `share` of the runs.
    """
    values = runs.reshape(*runs.shape[:2], -1)
    ax = style.axes_or_new(ax)
    for i in range(values.shape[2]):
        draw_band(ax, i, t, quantiles(values[:, :, i], share), names[i] if i < len(names) else None)
    ax.fill_between([], [], color=NEUTRAL, alpha=0.3, label=f"{100 * share:g} % of {len(values)} runs")
    style.over_time(ax, label)
    legend_above(ax)
    return ax


def quantiles(runs: FloatArray, share: float) -> FloatArray:
    """Return low, median and high (3, k) of runs (runs, k), with `share` of the runs between low and high."""
    with np.errstate(invalid="ignore"):  # infinite values leave a gap in the band
        return np.quantile(runs, [0.5 - 0.5 * share, 0.5, 0.5 + 0.5 * share], axis=0)


def draw_band(ax: Axes, i: int, t: FloatArray, band: FloatArray, label: str | None) -> None:
    """Draw a band (3, k) of low, median and high over t (k,), in the style of line i."""
    ax.fill_between(t, band[0], band[2], color=line(i)["color"], alpha=0.22, linewidth=0.0)
    ax.plot(t, band[1], label=label, **line(i))


@drawing
def plot_error_bands(
    runs: Sequence[Tracking], ax: Axes | None = None, share: float = 0.9, reach: float | None = None
) -> Axes:
    """Plot the distance from the end effector to the target over many runs as median and band.

    The tolerance `reach` [m] is dotted.
    """
    t = _common_time(runs)
    errors = np.array([run.position_error for run in runs])
    ax = plot_bands(t, errors, "distance to target [m]", ax=ax, share=share)
    if reach is not None:
        ax.axhline(reach, color=NEUTRAL, **LIMIT)
    ax.set_ylim(bottom=0.0)
    return ax


def _common_time(runs: Sequence[Tracking]) -> FloatArray:
    for k, run in enumerate(runs):
        if run.t.shape != runs[0].t.shape or not np.allclose(run.t, runs[0].t):
            text = f"must all have the same instants t, but runs[{k}] differs from runs[0]"
            raise InvalidValue("runs", run.t, text)
    return runs[0].t


def joint_factors(sms: SpaceManipulator) -> FloatArray:
    """Return the factors (n,) from radians to degrees; 1 for prismatic joints."""
    return np.array([unit.factor for unit in sms.layout.units])


@drawing
def plot_joint_positions(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Plot joint positions [deg or m] over time, with each limit that its joint comes near dotted.

    If `flown` differs visibly from the plan, both are drawn, the plan thin and pale.
    """
    factors = joint_factors(sms)
    motions = [
        (motion.t, [sms.layout.positions(q) for q in motion.q]) for motion in _motions(trajectory, flown)
    ]
    made = [Series(t, np.array(positions) * factors) for t, positions in motions]
    values = np.vstack([series.values for series in made])
    lower, upper = sms.limits.lower * factors, sms.limits.upper * factors
    room = _NEAR_LIMIT * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    low = np.where(values.min(axis=0) < lower + room, lower, -np.inf)
    high = np.where(values.max(axis=0) > upper - room, upper, np.inf)
    return _plot_joints(sms, ax, made, "joint position [{}]", (low, high))


@drawing
def plot_joint_rates(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Tracking | None = None
) -> Axes:
    """Plot joint rates [deg/s or m/s] over time, with dotted limits of joints that come near them.

    If no joint comes near a limit, the label states the largest share of a rate limit. `flown` is drawn as in
    `plot_joint_positions`.
    """
    factors = joint_factors(sms)
    made = [Series(motion.t, motion.v[:, 6:] * factors) for motion in _motions(trajectory, flown)]
    values = np.vstack([series.values for series in made])
    label, limits = near_limits(values, sms.limits.velocity * factors, "joint rate [{}/s]")
    return _plot_joints(sms, ax, made, label, limits)


def _plot_joints(
    sms: SpaceManipulator,
    ax: Axes | None,
    made: Sequence[Series],
    label: str,
    limits: Sequence[FloatArray] = (),
    units: tuple[str, str] = ("deg", "m"),
    steps: bool = False,
) -> Axes:
    """Draw values (k, n) of the joints in the `units` of revolute and of prismatic joints.

    If the robot has joints of both kinds, prismatic joints have an axis with another scale on the right.
    """
    turns, names = np.array(sms.layout.turns), list(sms.joint_names)
    if turns.all() or not turns.any():
        return plot_flown(ax, made, label.format(units[not turns.all()]), names, limits, steps)
    largest = np.abs(np.vstack([series.values for series in made])).max(axis=0, initial=0.0)
    ratio = float(largest[turns].max() / (largest[~turns].max() or 1.0)) or 1.0
    by = np.where(turns, 1.0, ratio)
    names = [name if turn else f"{name} (right)" for name, turn in zip(names, turns, strict=True)]
    scaled = [Series(series.t, series.values * by) for series in made]
    shown = [limit * by for limit in limits]
    ax = plot_flown(ax, scaled, label.format(units[0]), names, shown, steps)
    right = ax.secondary_yaxis(
        "right", functions=(lambda y: np.divide(y, ratio), lambda y: np.multiply(y, ratio))
    )
    right.set_ylabel(label.format(units[1]).partition("\n")[0])
    return ax


@drawing
def plot_base_position(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the displacement [mm] of the base's centre of mass from the start, in inertial axes.

    If `flown` differs visibly from the plan, both are drawn, the plan thin and pale.
    """
    return _plot_base(sms, trajectory, flown, ax, "base displacement [mm]", _displacements, slice(0, 3))


@drawing
def plot_base_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the velocity [mm/s] of the base's centre of mass, inertial axes.

    `flown` is drawn as in `plot_base_position`.
    """
    return _plot_base(sms, trajectory, flown, ax, "base velocity [mm/s]", _twists, slice(0, 3))


@drawing
def plot_base_rotation(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the rotation vector [deg] of the base from the start, in inertial axes.

    `flown` is drawn as in `plot_base_position`.
    """
    return _plot_base(sms, trajectory, flown, ax, "base rotation [deg]", _displacements, slice(3, 6))


@drawing
def plot_base_angular_velocity(
    sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None, flown: Motion | None = None
) -> Axes:
    """Plot the angular velocity [deg/s] of the base, inertial axes.

    `flown` is drawn as in `plot_base_position`.
    """
    return _plot_base(sms, trajectory, flown, ax, "base angular velocity [deg/s]", _twists, slice(3, 6))


def _plot_base(
    sms: SpaceManipulator,
    trajectory: Trajectory,
    flown: Motion | None,
    ax: Axes | None,
    label: str,
    of: Callable[[SpaceManipulator, FloatArray, FloatArray], FloatArray],
    columns: slice,
) -> Axes:
    """Plot three `columns` of the base's values (k, 6) that `of` returns for q (k, nq) and v (k, nv)."""
    made = []
    for motion in _motions(trajectory, flown):
        rows = thinned(len(motion.t))
        made.append(Series(motion.t[rows], of(sms, motion.q[rows], motion.v[rows])[:, columns]))
    return plot_flown(ax, made, label, "xyz")


def _motions(trajectory: Trajectory, flown: Motion | None) -> list[Motion]:
    return [trajectory] if flown is None else [trajectory, flown]


def _displacements(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray(_UNITS * base_motion(sms, q))


def _twists(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray(_UNITS * [sms.at(*state).base_twist for state in zip(q, v, strict=True)])


@drawing
def plot_joint_error(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Plot joint position errors [deg or m], simulated minus planned."""
    values = tracking.joint_error * joint_factors(sms)
    return _plot_joints(sms, ax, [Series(tracking.t, values)], "joint error [{}]")


@drawing
def plot_joint_rate_error(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Plot joint rate errors [deg/s or m/s], simulated minus planned."""
    values = tracking.joint_rate_error * joint_factors(sms)
    return _plot_joints(sms, ax, [Series(tracking.t, values)], "joint rate error [{}/s]")


@drawing
def plot_tracked_position_error(
    tracking: Tracking, ax: Axes | None = None, open_loop: Tracking | None = None
) -> Axes:
    """Plot the distance from the simulated end effector to the target, or to the path of an `opt.Path`.

    `open_loop`, drawn as a second line, is the run that follows the first plan if `tracking` was re-planned.
    """
    label = "distance to target [m]"
    if open_loop is None:
        ax = plot_series(ax, tracking.t, tracking.position_error, label)
    else:
        # A run that stops early has fewer rows.
        longer = max(tracking, open_loop, key=lambda run: len(run.t))
        both = np.full((len(longer.t), 2), np.nan)
        for column, run in enumerate((tracking, open_loop)):
            both[: len(run.t), column] = run.position_error
        ax = plot_series(ax, longer.t, both, label, ("re-planned", "planned once"))
    ax.set_ylim(bottom=0.0)
    return ax


@drawing
def plot_torques(
    sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None, limits: FloatArray | None = None
) -> Axes:
    """Plot joint torques [N m or N], constant over each control step; `limits` (n,) are dotted.

    By default no limits are drawn, because distant limits would flatten the curves.
    """
    if limits is not None and not (isinstance(limits, np.ndarray) and limits.shape == (sms.n,)):
        raise InvalidValue("limits", limits, f"must be a NumPy array of shape ({sms.n},) [N m or N]")
    label, drawn = "joint torque [{}]", () if limits is None else (-limits, limits)
    made = [Series(tracking.t[: len(tracking.tau)], tracking.tau)]
    return _plot_joints(sms, ax, made, label, drawn, ("N m", "N"), steps=True)


@drawing
def plot_wheel_momentum(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Plot the planned spin momenta [N m s] of the wheels that turn; limits as in `plot_wheels`."""
    return _plot_turning_wheels(sms, trajectory, ax, trajectory.wheel_momentum)


@drawing
def plot_wheels(
    sms: SpaceManipulator, trajectory: Trajectory, tracking: Tracking, ax: Axes | None = None
) -> Axes:
    """Plot the simulated spin momenta [N m s] of the wheels that turn, with any planned momenta dashed.

    Wheels with the same momentum share a line, and its label names them. Limits that a wheel comes near are
    dotted. If no wheel comes near its limit, the label of the axis states the largest share of a limit.
    """
    ax = _plot_turning_wheels(sms, tracking, ax, tracking.wheel_momentum)
    planned = trajectory.wheel_momentum
    if planned.any():
        for k, (first, *_) in enumerate(_alike(tracking.wheel_momentum)):
            label = None if k else "planned"
            ax.plot(trajectory.t, planned[:, first], "--", color="#111111", linewidth=0.8, label=label)
        legend_above(ax)
    return ax


@drawing
def plot_wheel_torque(sms: SpaceManipulator, tracking: Tracking, ax: Axes | None = None) -> Axes:
    """Plot the motor torques [N m] of the wheels that turn; limits as in `plot_wheels`."""
    return _plot_turning_wheels(sms, tracking, ax, tracking.wheel_torque, torque=True)


def _plot_turning_wheels(
    sms: SpaceManipulator, motion: Motion, ax: Axes | None, values: FloatArray, torque: bool = False
) -> Axes:
    """Draw momenta or torques (k, w), with one line for wheels of equal momentum, as in `plot_wheels`."""
    if sms.wheels is None:
        raise InvalidValue("sms", sms, "must have wheels: sms.with_actuators(wheels=...)")
    wheels, names = sms.wheels, sms.wheels.names
    groups = _alike(motion.wheel_momentum) or [list(range(len(names)))]  # one group if all wheels rest
    first = [group[0] for group in groups]
    quantity, most = ("torque [N m]", wheels.torque) if torque else ("momentum [N m s]", wheels.momentum)
    label, limits = near_limits(values, most, f"wheel {quantity}")
    labels = [coincident([names[i] for i in group]) for group in groups]
    t, drawn = motion.t[: len(values)], [limit[first] for limit in limits]
    return plot_series(ax, t, values[:, first], label, labels, drawn, steps=torque)


def _alike(momentum: FloatArray) -> list[list[int]]:
    """Group the indices of the turning wheels whose momenta (k, w) are equal at all times."""
    largest = float(np.abs(momentum).max(initial=0.0))
    groups: dict[int, list[int]] = {}
    for i in np.flatnonzero(np.abs(momentum).max(axis=0, initial=0.0) > _STILL * largest).tolist():
        same = np.abs(momentum - momentum[:, [i]]).max(axis=0) <= _ALIKE * largest
        groups.setdefault(next((first for first in groups if same[first]), i), []).append(i)
    return list(groups.values())
