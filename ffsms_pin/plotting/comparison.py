"""The planning methods side by side: distance left, assistance, and how far the base turns."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ffsms_pin.plotting.style import applied, line, stack
from ffsms_pin.scenarios.compare import Comparison
from ffsms_pin.studies.extremes import base_motion

__all__ = ["plot_comparison"]


def plot_comparison(comparison: Comparison) -> Figure:
    """A figure with three panels over time, one line a method.

    Parameters
    ----------
    comparison : Comparison
    """
    figure, (distance, assistance, rotation) = stack(3)
    with applied():
        for i, (method, made) in enumerate(comparison.plans.items()):
            label = method if made.reached else f"{method} (not reached)"
            distance.plot(made.t, made.position_error, label=label, **line(i))
            assistance.plot(made.t[:-1], made.cos_theta, **line(i))
            turn = np.degrees(np.linalg.norm(base_motion(comparison.sms, made.q).rotation, axis=1))
            rotation.plot(made.t, turn, **line(i))
        distance.set_ylabel("distance to target [m]")
        distance.set_ylim(bottom=0.0)
        assistance.set_ylabel(r"assistance $\cos\,\theta_a$ [-]")
        assistance.set_ylim(-1.08, 1.08)
        rotation.set_ylabel("base rotation [deg]")
        rotation.set_xlabel("time [s]")
        distance.set_xlim(0.0, max(made.duration for made in comparison.plans.values()))
        figure.legend(loc="outside upper center", ncols=2)
    return figure
