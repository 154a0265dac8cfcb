"""What wheels take up: along a plan, and with coupling used and fought side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffsms_pin.opt import Trajectory
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.plotting.style import applied, line, stack
from ffsms_pin.scenarios.extremes import base_motion
from ffsms_pin.scenarios.modes import ModeComparison, Strategy
from ffsms_pin.system import SpaceManipulator

__all__ = ["plot_modes", "plot_wheel_momentum"]


def plot_wheel_momentum(sms: SpaceManipulator, trajectory: Trajectory, ax: Axes | None = None) -> Axes:
    """Predicted spin momentum of each wheel; its largest dotted where a wheel uses half of it or more."""
    momentum, wheels = trajectory.wheel_momentum, sms.wheels
    if wheels is None:
        return plot_series(ax, trajectory.t, np.zeros((len(trajectory.t), 0)), "wheel momentum [N m s]")
    near = np.where(np.abs(momentum).max(axis=0) > 0.5 * wheels.momentum, wheels.momentum, np.inf)
    return plot_series(ax, trajectory.t, momentum, "wheel momentum [N m s]", wheels.names, (near, -near))


def plot_modes(comparison: ModeComparison) -> Figure:
    """A figure with three panels over time, one line a strategy.

    Largest wheel momentum, base rotation, and distance to the target; turning back comes after the plan.

    Parameters
    ----------
    comparison : ModeComparison
    """
    figure, (momentum, rotation, distance) = stack(3)
    with applied():
        for i, (name, one) in enumerate(comparison.found.items()):
            label = name if one.plan.reached else f"{name} (not reached)"
            momentum.plot(*_momentum(one), label=label, **line(i))
            turn = np.degrees(np.linalg.norm(base_motion(comparison.sms, one.plan.q).rotation, axis=1))
            t = one.plan.t
            if one.after is not None:  # along the cubic of `turn_back`
                s = one.after.t / one.after.t[-1]
                t = np.concatenate([t, t[-1] + one.after.t])
                turn = np.concatenate([turn, turn[-1] * (1.0 - 3.0 * s**2 + 2.0 * s**3)])
            rotation.plot(t, turn, **line(i))
            distance.plot(one.plan.t, one.plan.position_error, **line(i))
        momentum.set_ylabel("largest wheel\nmomentum [N m s]")
        rotation.set_ylabel("base rotation [deg]")
        distance.set_ylabel("distance to target [m]")
        distance.set_xlabel("time [s]")
        distance.set_xlim(left=0.0)
        figure.legend(loc="outside upper center", ncols=3)
    return figure


def _momentum(one: Strategy) -> tuple[np.ndarray, np.ndarray]:
    """Instants, and the largest size of any wheel's momentum; then while turning back."""
    t, largest = one.during.t, np.abs(one.during.momentum).max(axis=1, initial=0.0)
    if one.after is not None:
        t = np.concatenate([t, t[-1] + one.after.t])
        largest = np.concatenate([largest, np.abs(one.after.momentum).max(axis=1, initial=0.0)])
    return t, largest
