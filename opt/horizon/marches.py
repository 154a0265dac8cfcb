"""Starts from the paper's step: coarse marches, each fitted by a spline.

A march is free of cost wherever nothing stops it, and moves the joints little; it may arrive where no straight move
does.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.march import march, start_sides
from ffsms_pin.opt.step.stepper import Stepper

__all__ = ["march_starts"]


def march_starts(problem: Problem, spline: RateSpline, options: SearchOptions) -> list[FloatArray]:
    """Control points (M, n) nearest to marches, one for each side of the cost's cone and one straight ahead."""
    place = problem.goal.place(problem.duration)
    if problem.locked:
        return []
    steps = min(problem.steps, options.march_steps)
    times = np.linspace(0.0, problem.duration, steps + 1)
    to_points = spline.rates_at(times)
    found = []
    sides = start_sides(problem.sms, problem.q0, place.position)
    for reference, side in [*(("step", side) for side in sides), ("resolved-rate", np.zeros(3))]:
        stepper = Stepper(
            problem.sms,
            problem.duration / steps,
            problem.kappa,
            problem.limits,
            reference=reference,
            momentum=problem.momentum,
        )
        stepper.reset(side)
        rates = march(
            stepper, problem.q0, problem.joint_rates, place.position, problem.duration, place.rotation
        ).rates
        rest = rates - to_points.fixed[:, None] * problem.joint_rates
        found.append(np.linalg.lstsq(to_points.free, rest, rcond=None)[0])
    return found
