"""The control laws side by side: distance left, joint error, and the torques they take."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ffsms_pin.plotting.joints import joint_factors, joint_unit_label
from ffsms_pin.plotting.style import LIMIT, NEUTRAL, applied, line, stack
from ffsms_pin.scenarios.compare import LawComparison

__all__ = ["plot_laws"]

_DEEPEST = 1e-5  # of the best law's largest error: what is below is rounding, or a start without error


def plot_laws(comparison: LawComparison) -> Figure:
    """A figure with three panels over time, one line a law.

    Distance to the target and largest joint error on logarithmic axes, and the torque effort so far.
    """
    figure, (distance, error, effort) = stack(3)
    factors = joint_factors(comparison.sms)
    largest: list[float] = []
    with applied():
        for i, (law, (run, stopped)) in enumerate(comparison.runs.items()):
            label = f"{law} (stopped)" if stopped else law
            look = line(i)
            distance.semilogy(run.t, run.position_error, label=label, **look)
            if len(run.t) > 0:
                errors = np.abs(run.joint_error * factors).max(axis=1)
                largest.append(float(errors.max()))
                error.semilogy(run.t, errors, **look)
            if len(run.tau) > 0:
                step = float(run.t[1] - run.t[0])
                so_far = np.concatenate([[0.0], np.cumsum(np.square(run.tau).sum(axis=1)) * step])
                effort.plot(run.t[: len(so_far)], so_far, **look)
        reach = comparison.plan.reach
        distance.axhline(reach, color=NEUTRAL, label=f"reach, {1e3 * reach:g} mm", **LIMIT)
        distance.set_ylabel("distance to target [m]")
        error.set_ylabel(f"largest joint\nerror [{joint_unit_label(comparison.sms)}]")
        if any(largest):
            error.set_ylim(bottom=_DEEPEST * min(value for value in largest if value > 0.0))
        effort.set_ylabel("torque effort\nso far [N²m²s]")
        effort.set_ylim(bottom=0.0)
        effort.set_xlabel("time [s]")
        effort.set_xlim(0.0, comparison.scenario.duration)
        figure.legend(loc="outside upper center", ncols=3)
    return figure
