"""Why a plan failed: the start, the workspace, the time, or what stood in the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffsms_pin.opt.horizon.motion import least_clearance
from ffsms_pin.opt.horizon.starts import Goals, halton, joint_range, straight_time
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE, REACH, Trajectory, measure
from ffsms_pin.system.base_motion import roll_out

__all__ = ["explain", "reach_range", "start_in_collision", "within_workspace"]

# Joint positions from which the longest and the shortest reach are looked for, and steps of the ascent.
_SAMPLES, _ASCENT = 64, 40
# A duration that is tried is longer than the failed one by this factor at least, and longer by the other one
# than the straight move to the nearest goal found.
_LONGER, _MORE_THAN_STRAIGHT = 1.25, 1.1
_ATTEMPTS = 2  # the second twice as long; the diagnosis takes no longer than three searches


def start_in_collision(task: Task) -> Trajectory | None:
    """A plan that stays where it is, where the start already breaks the clearance; else None."""
    least, between = least_clearance(task, task.joints0[:, None])
    if least >= task.clearance:
        return None
    note = (
        f"the start breaks the clearance: {between} is {1e3 * least:.1f} mm, "
        f"{1e3 * task.clearance:.1f} mm are asked; move the start, or ask for less"
    )
    t = np.linspace(0.0, task.duration, task.steps + 1)
    q, rates = np.tile(task.q0, (len(t), 1)), np.zeros((len(t), task.arm.n))
    if task.momentum is not None:
        q, _ = roll_out(task.sms, task.q0, rates[0], rates[1:], task.dt, task.momentum)
    plan = measure(task.sms, t, q, rates, task.target, task.kappa, note, task.rotation, task.momentum)
    return replace(plan, clear=False)


def explain(
    task: Task,
    plan: Trajectory,
    goals: Goals,
    binding: list[tuple[str, int]],
    attempt: Callable[[Task], Trajectory],
) -> Trajectory:
    """The failed plan with a note: how near it came, what binds, and a duration that would do.

    Parameters
    ----------
    task : Task
    plan : Trajectory
        The best there is.
    goals : Goals
        Joint goals that the search tried.
    binding : list of (str, int)
        Limits that the plan touches: kind and joint.
    attempt : callable
        Plans another task; for longer durations.
    """
    x, y, z = plan.end_effector[-1]
    words = [
        f"ends {plan.position_error[-1]:.4f} m from the target, at ({x:.4f}, {y:.4f}, {z:.4f}), "
        "the nearest position found"
    ]
    if task.rotation is not None:
        words[0] += f", turned {plan.orientation_error[-1]:.4f} rad from the wanted attitude"
    if plan.note:
        words.append(plan.note)
    elif not plan.clear:
        words.append("breaks a clearance on the way")
    distance, least, most = distances(task)
    if not least - REACH <= distance <= most + REACH:
        words.append(
            f"binding: the workspace, since the end effector can be {least:.3f} to {most:.3f} m from the "
            f"system's centre of mass and the target is {distance:.3f} m from it"
        )
        return replace(plan, note="; ".join(words))
    if binding:
        names = [f"{kind} limit of '{task.sms.joint_names[i]}'" for kind, i in binding[:3]]
        words.append(f"binding: {', '.join(names)}")
    shortest = _sufficient(task, goals, attempt)
    if shortest > 0.0:
        words.append(f"a duration of {shortest:.2f} s would do")
    else:
        words.append("no duration that would do is known")
    return replace(plan, note="; ".join(words), shortest_duration=shortest)


def within_workspace(task: Task) -> bool:
    """Whether the target is as far from the system's centre of mass as the end effector can be."""
    distance, least, most = distances(task)
    return least - REACH <= distance <= most + REACH


def distances(task: Task) -> tuple[float, float, float]:
    """Of the target from the system's centre of mass at the deadline, and the range that can be had [m]."""
    return float(np.linalg.norm(task.goal - task.duration * task.drift)), *reach_range(task)


def reach_range(task: Task) -> tuple[float, float]:
    """Least and greatest distance of the end effector from the system's centre of mass, over the joint range.

    The base's attitude does not change it, and it holds for all motions from rest: the centre stays.
    """
    low, high = joint_range(task)
    seeds = low + (high - low) * halton(0, _SAMPLES, task.arm.n)
    found = []
    for sense in (-1.0, 1.0):
        joints, best = seeds, np.inf
        for k in range(_ASCENT):
            arm = task.arm.evaluate(joints.T)
            distance = np.linalg.norm(arm.rho, axis=0)
            best = min(best, float((-sense * distance).min()))
            slope = np.einsum("inb,ib->bn", arm.arm - arm.linear / task.arm.mass, arm.rho)
            step = sense * slope / np.maximum(np.abs(slope).max(axis=1, keepdims=True), 1e-9)
            joints = np.clip(joints + 0.5 * 0.88**k * step, low, high)
        found.append(abs(best))
    return found[0], found[1]


def _sufficient(task: Task, goals: Goals, attempt: Callable[[Task], Trajectory]) -> float:
    """A duration [s] for which the target is reached, as short as a few attempts can tell; 0: none found."""
    longer = _LONGER * task.duration
    if goals.distance.size:
        nearest = goals.joints[int(np.argmin(goals.distance))]
        longer = max(longer, _MORE_THAN_STRAIGHT * straight_time(task, nearest) / ARRIVAL_SHARE)
    shorter = task.duration
    for _ in range(_ATTEMPTS):
        if attempt(_lasting(task, longer)).reached:
            between = 0.5 * (shorter + longer)
            return between if attempt(_lasting(task, between)).reached else longer
        shorter, longer = longer, 2.0 * longer
    return 0.0


def _lasting(task: Task, duration: float) -> Task:
    """The same task with another duration, in the same number of steps."""
    factor = duration / task.duration
    return replace(task, duration=duration, dt=task.dt * factor, pace=task.pace / factor)
