"""The verdict of a recording: by its reference's problem, or by its target alone."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, from_homogeneous
from ffsms_pin.opt.flown import Verdict, judge
from ffsms_pin.opt.goals.goal import ORIENTATION_REACH, REACH
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.replanning import Replanning
from ffsms_pin.references import Reference
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.system.dynamics import frame_pose


@runtime_checkable
class _HasProblem(Protocol):
    """A reference with the problem that it solves, or None."""

    problem: Problem | None


def judged(tracking: Tracking, reference: Reference, plant: SpaceManipulator) -> Tracking:
    """Return a recording with its verdict. A flight that a guard stopped has not arrived.

    A `Trajectory` and an `opt.Replanning` have their problem: every goal and limit of it counts. Of another
    reference the target at the end counts, within the paper's r_th of 20 mm and, if it is a pose, 0.02 rad.
    """
    if not len(tracking.t):
        return replace(
            tracking, misses=("nothing was recorded",), note=tracking.note or "nothing was recorded"
        )
    problem = reference.problem if isinstance(reference, _HasProblem) else None
    problem = reference.task if isinstance(reference, Replanning) else problem
    if isinstance(problem, Problem):
        verdict = judge(problem, plant, tracking.t, tracking.q, tracking.v, tracking.wheel_momentum)
    else:
        verdict = _by_target(tracking, reference, plant)
    if tracking.stopped:
        verdict = replace(verdict, misses=(tracking.stopped, *verdict.misses))
    missed = f"not arrived: {'; '.join(verdict.misses)}" if verdict.misses else ""
    why = reference.note if verdict.misses and isinstance(reference, Replanning) else ""
    note = "; ".join(filter(None, [missed, why, *verdict.breaches, tracking.note]))
    rows = len(tracking.t)
    errors = [np.zeros((rows, 0, 2)), *(error[:, None] for error in verdict.frame_errors.values())]
    return replace(
        tracking,
        arrived=verdict.arrived,
        note=note,
        position_error=verdict.path_error if len(verdict.path_error) else tracking.position_error,
        orientation_error=verdict.orientation_error,
        frames=tuple(verdict.frame_errors),
        frame_error=np.concatenate(errors, axis=1),
        misses=verdict.misses,
        least_clearance=verdict.clearance,
    )


def _by_target(tracking: Tracking, reference: Reference, plant: SpaceManipulator) -> Verdict:
    """Return the verdict of a recording by its target alone."""
    off, misses, target = float(tracking.position_error[-1]), [], reference.target
    angles: FloatArray = np.zeros(len(tracking.t))

    def wanted(t: float) -> Any:
        return from_homogeneous("target", target(t) if callable(target) else target)

    if isinstance(wanted(float(tracking.t[-1])), pin.SE3):
        rows = zip(tracking.t.tolist(), tracking.q, strict=True)
        angles = np.array([_angle(wanted(t).rotation.T @ frame_pose(plant, q).rotation) for t, q in rows])
    if off > REACH:
        misses.append(
            f"the end effector ends {1e3 * off:.3g} mm from its target, {1e3 * REACH:.3g} mm are allowed"
        )
    if angles[-1] > ORIENTATION_REACH:
        both = math.degrees(angles[-1]), math.degrees(ORIENTATION_REACH)
        misses.append("its attitude ends {:.3g} deg off, {:.3g} deg are allowed".format(*both))
    return Verdict(tuple(misses), orientation_error=angles)


def _angle(rotation: FloatArray) -> float:
    return float(np.linalg.norm(pin.log3(rotation)))
