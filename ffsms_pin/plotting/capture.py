"""A capture over time: how fast the base turns, as said before and as found, and the joints that brake."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes

from ffsms_pin.plotting.joints import joint_factors, joint_unit_label
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.plotting.style import applied, legend_above
from ffsms_pin.scenarios import Outcome

__all__ = ["plot_braking", "plot_turning"]

_SAID: dict[str, Any] = {"color": "black", "linewidth": 0.8, "linestyle": (0, (4, 3))}


def plot_turning(outcome: Outcome, ax: Axes) -> Any:
    """Angular velocity of the base from the rigid capture on [deg/s]; dashed: as said before the flight."""
    capture = outcome.capture
    if capture is None:
        return ax
    tracking = capture.tracking
    turns = pin.Quaternion
    rates = np.degrees(
        [turns(q[3:7]).toRotationMatrix() @ v[3:6] for q, v in zip(tracking.q, tracking.v, strict=True)]
    )
    offset = 0.0 if capture.contact is None else float(capture.contact.t[-1])
    t = tracking.t + offset
    rest = t[t >= capture.planned_braking]
    said = np.degrees(capture.planned_rest.twists(rest - capture.planned_braking)[:, 3:])
    names = [f"$\\omega_{axis}$" for axis in "xyz"]
    ax = plot_series(ax, t, rates, "base rate [deg/s]", names)
    with applied():
        for i in range(3):
            ax.plot(rest, said[:, i], label="as said before" if i == 0 else None, **_SAID)
        legend_above(ax, [*names, "as said before"])
        ax.set_xlabel("time since the contact [s]")
        ax.set_xlim(left=0.0)
    return ax


def plot_braking(outcome: Outcome, ax: Axes) -> Any:
    """Joint rates from the rigid capture on."""
    capture = outcome.capture
    if capture is None:
        return ax
    offset = 0.0 if capture.contact is None else float(capture.contact.t[-1])
    ax = plot_series(
        ax,
        capture.tracking.t + offset,
        capture.tracking.v[:, 6 : 6 + outcome.sms.n] * joint_factors(outcome.sms),
        f"joint rate [{joint_unit_label(outcome.sms)}/s]",
        outcome.sms.joint_names,
    )
    ax.set_xlabel("time since the contact [s]")
    return ax
