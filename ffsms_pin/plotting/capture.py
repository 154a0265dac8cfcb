"""A capture over time: how fast the base turns, as said before and as found, and the joints that brake."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes

from ffsms_pin.plotting.style import line
from ffsms_pin.scenarios import Outcome

__all__ = ["plot_braking", "plot_turning"]


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
    for i, axis in enumerate("xyz"):
        style = line(i)
        ax.plot(t, rates[:, i], label=f"$\\omega_{axis}$", **style)
        ax.plot(rest, said[:, i], color="black", linewidth=0.8, linestyle=(0, (4, 3)))
    ax.set_ylabel("base rate [deg/s]")
    ax.set_xlabel("time since the contact [s]")
    ax.legend(loc="best", ncols=3)
    return ax


def plot_braking(outcome: Outcome, ax: Axes) -> Any:
    """Joint rates from the rigid capture on [deg/s]."""
    capture = outcome.capture
    if capture is None:
        return ax
    offset = 0.0 if capture.contact is None else float(capture.contact.t[-1])
    for i, name in enumerate(outcome.sms.joint_names):
        rates = np.degrees(capture.tracking.v[:, 6 + i])
        ax.plot(capture.tracking.t + offset, rates, label=name, **line(i))
    ax.set_ylabel("joint rates [deg/s]")
    ax.set_xlabel("time since the contact [s]")
    return ax
