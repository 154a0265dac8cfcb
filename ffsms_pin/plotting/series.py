"""The one way a quantity is drawn over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.style import (
    AS_PLANNED,
    LIMIT,
    LIMITS,
    NEUTRAL,
    PLANNED,
    applied,
    axes_or_new,
    legend_above,
    line,
)
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["Series", "check_kinds", "plot_flown", "plot_series"]

_SAME = 0.02  # of the largest planned value: what differs by less is drawn once
_ROWS = 1500  # of a recording: more than a panel has room for help nobody


_KINDS: dict[str, Any] = {
    "sms": SpaceManipulator, "trajectory": Trajectory, "tracking": Tracking, "result": (Trajectory, Tracking),
    "flown": (Trajectory, Tracking), "open_loop": Tracking,
}  # fmt: skip
_OPTIONAL = ("flown", "open_loop")


def check_kinds(**given: Any) -> None:
    """Raise `InvalidValue` unless each argument is what its name says, and motions are of the robot."""
    for name, value in given.items():
        instance(name, value, _KINDS[name], optional=name in _OPTIONAL)
        if "sms" in given and name != "sms" and value is not None and value.q.shape[1] != given["sms"].nq:
            raise InvalidValue(name, value, "must be a motion of this robot")


class Series(NamedTuple):
    """Values (k, m) over times t (k,) [s]."""

    t: FloatArray
    values: FloatArray


def plot_series(
    ax: Axes | None,
    t: FloatArray,
    values: FloatArray,
    label: str,
    names: Sequence[str] = (),
    limits: Sequence[FloatArray] = (),
    steps: bool = False,
) -> Axes:
    """Draw values (k,) or (k, m) over t (k,) [s].

    Parameters
    ----------
    ax : Axes or None
        None makes a new figure.
    t, values : ndarray
    label : str
        Of the vertical axis, with the unit.
    names : sequence of str
        Of the m lines, for the legend.
    limits : sequence of ndarray, each of shape (m,)
        Drawn dotted, in the colour of their line; those that are not finite are left out.
    steps : bool
        Whether a value holds until the next instant, instead of a straight line to it.
    """
    with applied():
        ax = axes_or_new(ax)
        columns = values.reshape(len(values), -1)
        for i in range(columns.shape[1]):
            name = names[i] if names else None
            ax.plot(t, columns[:, i], label=name, drawstyle="steps-post" if steps else "default", **line(i))
        drawn: list[float] = []
        for limit in limits:
            for i, value in enumerate(limit):
                if np.isfinite(value):
                    # A limit that several joints share is drawn once, in a colour that belongs to none.
                    shared = int(np.sum(np.isclose(limit, value))) > 1
                    if shared and any(np.isclose(value, drawn)):
                        continue
                    drawn.append(float(value))
                    ax.axhline(value, color="#555555" if shared else line(i)["color"], **LIMIT)
        if drawn:
            ax.plot([], [], color="#555555", label=LIMITS, **LIMIT)
        ax.set_xlabel("time [s]")
        ax.set_ylabel(label)
        ax.margins(x=0.0)
        if names or drawn:
            labels = [*names, *([LIMITS] if drawn else [])]
            legend_above(ax, labels)
    return ax


def plot_flown(
    ax: Axes | None,
    planned: Series,
    flown: Series | None,
    label: str,
    names: Sequence[str],
    limits: Sequence[FloatArray] = (),
) -> Axes:
    """Draw what was flown, and thin and pale what was planned where that differs; else the plan alone."""
    if flown is None or not _differs(planned, flown):
        return plot_series(ax, planned.t, planned.values, label, names, limits)
    rows = np.unique(np.linspace(0, len(flown.t) - 1, min(_ROWS, len(flown.t))).astype(int))
    ax = plot_series(ax, flown.t[rows], flown.values[rows], label, names, limits)
    with applied():
        for i in range(planned.values.shape[1]):
            ax.plot(planned.t, planned.values[:, i], color=line(i)["color"], **PLANNED)
        ax.plot([], [], color=NEUTRAL, label=AS_PLANNED, **PLANNED)
        legend_above(ax, ax.get_legend_handles_labels()[1])
    return ax


def _differs(planned: Series, flown: Series) -> bool:
    """Whether two motions differ by more than a line's width, as long as both last."""
    both = planned.t <= flown.t[-1] + 1e-9
    found = [np.interp(planned.t[both], flown.t, column) for column in flown.values.T]
    largest = float(np.abs(planned.values).max(initial=0.0))
    apart = float(np.abs(np.array(found).T - planned.values[both]).max(initial=0.0))
    return apart > max(_SAME * largest, 1e-9)
