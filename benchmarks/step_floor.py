"""Compare a planning step with the least library calls that it needs.

The floor of a step is the time of its calls into Pinocchio, LAPACK and ProxQP, with the same states and
matrices, in the same run. A third table has the times of the functions that a step calls. Print the Markdown
tables:

    OMP_NUM_THREADS=1 python benchmarks/step_floor.py

Other programs on the machine lengthen single calls by milliseconds. Therefore a rollout is repeated with
identical steps, and the time of a step is the shortest of its repetitions.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pinocchio as pin
from proxsuite import proxqp
from scipy.linalg import lapack

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.joint_limits import JointLimits
from ffsms_pin.opt.step import stepper
from ffsms_pin.opt.step.stepper import Stepper, StepProblem, StepSolver, new_solver
from ffsms_pin.opt.step.stepwise import sides_of
from ffsms_pin.robot.base_motion import advance

DT, KAPPA = 0.01, 10.0  # [s] time step; kappa of the paper's cost C~
MODELS = ("planar_3r", "satellite_panda")
# The functions that a step calls: their module or class, and their names.
PARTS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "checks of the arguments": (Stepper, ("_checked",)),
    "state: J*, V, entropy, bounds on the rates": (stepper, ("StepState",)),
    "rows of the joint limits": (JointLimits, ("rows",)),
    "rows of the clearances": (Clearance, ("rows",)),
    "rows of the box": (AlphaBox, ("rows",)),
    "direction, objective, all rows in alpha": (stepper, ("ideal_cosine", "step_qp")),
    "ProxQP, its active rows solved exactly": (StepSolver, ("solve",)),
}
REST = "remainder: rates, cosine, cost, reading the clock"
CALLS = ("crba with Jacobians", "frame Jacobian", "6 x 6 solve", "SVD", "ProxQP, warm")


class Task(NamedTuple):
    """A rollout: its states, and its QPs."""

    sms: ffsms.SpaceManipulator
    target: FloatArray
    side: FloatArray
    states: list[tuple[FloatArray, FloatArray, float]]
    problems: list[StepProblem]


def run(repeats: int = 7) -> dict[str, Any]:
    """Time steps and their floors for the packaged robots, with joint limits and the paper's clearances.

    Parameters
    ----------
    repeats : int
        The number of repeats of each rollout.

    Returns
    -------
    dict
        One entry for each model: `calls` (medians of the floor's calls), `floor` (median of their sum),
        `step`, `step_p999` and `step_worst`, `parts` (medians of its parts and of the remainder), in us;
        `ratio` = step / floor; `tail` = step_p999 / step; `steps`.
    """
    return {name: measure(roll_out_steps(name), repeats) for name in MODELS}


def roll_out_steps(name: str) -> Task:
    """Roll out a long motion of the planar arm, or one of similar size with another robot."""
    sms = ffsms.load(name)
    if name == "planar_3r":
        q, duration = sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), 12.0
        target = np.array([0.45, 0.75, 0.0])
    else:
        middle, spread = (
            0.5 * (sms.limits.upper + sms.limits.lower),
            sms.limits.upper - sms.limits.lower,
        )
        q, duration = sms.configuration(middle), 8.0
        goal = middle + 0.25 * spread * np.random.default_rng(1).uniform(-1.0, 1.0, sms.n)
        target = sms.at(sms.configuration(goal)).end_effector_pose.translation.copy()
    side = sides_of(opt.Problem(sms, q, target))[0]
    planner, inspected = _stepper(sms), _stepper(sms)
    planner.reset(side)
    inspected.reset(side)
    rates, states, problems = np.zeros(sms.n), [], []
    for k in range(round(duration / DT)):
        states.append((q, rates, duration - k * DT))
        problems.append(inspected.build(q, rates, target, duration - k * DT))
        chosen = planner.step(q, rates, target, duration - k * DT).joint_rates
        q, rates = advance(sms, q, rates, (chosen - rates) / DT, DT)
    return Task(sms, target, side, states, problems)


def _stepper(sms: ffsms.SpaceManipulator) -> Stepper:
    """Return a stepper with the limits of the paper."""
    return Stepper(sms, DT, KAPPA, (JointLimits(), Clearance(), AlphaBox()))


def measure(task: Task, repeats: int) -> dict[str, Any]:
    """Measure the times of a rollout's steps and of their floors [us]."""
    empty = _clock()
    # Step and floor are timed alternately, so that other load slows both.
    times = [(_steps(task), _floors(task), _parts(task)) for _ in range(repeats)]
    steps = np.min([step for step, _, _ in times], axis=0) - empty
    floors = np.array([floor for _, floor, _ in times]) - empty
    parts = np.median(np.min([part for _, _, part in times], axis=0), axis=0) - empty
    # The least total time of the calls in one run, as for the step.
    step, floor = float(np.median(steps)), float(np.median(floors.sum(axis=2).min(axis=0)))
    p999 = float(np.percentile(steps, 99.9))
    return {
        "calls": dict(zip(CALLS, np.median(floors.min(axis=0), axis=0).tolist(), strict=True)),
        "floor": floor,
        "step": step,
        "step_p999": p999,
        "step_worst": float(steps.max()),
        "ratio": step / floor,
        "tail": p999 / step,
        "parts": dict(zip((*PARTS, REST), parts.tolist(), strict=True)),
        "steps": len(steps),
    }


def _clock() -> float:
    """Return the time between two successive readings of the clock [us]."""
    now = time.perf_counter_ns
    return 1e-3 * float(np.median([-(now() - now()) for _ in range(10000)]))


def _steps(task: Task) -> FloatArray:
    """Return the time of each step (N,) [us]."""
    planner, now, spent = _stepper(task.sms), time.perf_counter_ns, []
    planner.reset(task.side)
    for q, rates, left in task.states:
        begin = now()
        planner.step(q, rates, task.target, left)
        spent.append(now() - begin)
    return 1e-3 * np.array(spent)


def _floors(task: Task) -> FloatArray:
    """Return the time of each call of each step, (N, calls) [us]."""
    sms, now = task.sms, time.perf_counter_ns
    model, data, frame = sms.model, sms.model.createData(), sms.frame_id
    # The bounds s >= 0 and slack >= 0 are rows, too, as in the step.
    bounds = np.eye(sms.n + 2)[-2:]
    qp = new_solver(sms.n + 2, len(task.problems[0].C) + 2)
    alpha_and_more, z, V = np.zeros(sms.n + 2), np.zeros(len(task.problems[0].C) + 2), np.eye(sms.n)
    axes, world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED, pin.Convention.WORLD
    rows: list[tuple[int, ...]] = []
    for (q, _, _), p in zip(task.states, task.problems, strict=True):
        give: Callable[..., None] = qp.update if rows else qp.init
        options = {} if rows else {"compute_preconditioner": False}
        C = np.concatenate([p.C, bounds])
        low, up = np.concatenate([p.l, p.lower[-2:]]), np.concatenate([p.u, p.upper[-2:]])
        # The previous solution in this step's basis, as in the step; the joint limits are the first rows.
        rates, V = V.dot(alpha_and_more[: sms.n]), p.C[: sms.n, : sms.n]
        start = np.concatenate([rates.dot(V), alpha_and_more[sms.n :]])
        t0 = now()
        M = pin.crba(model, data, q, world)
        t1 = now()
        pin.updateFramePlacement(model, data, frame)
        pin.getFrameJacobian(model, data, frame, axes)
        t2 = now()
        _, coupling, _ = lapack.dposv(M[:6, :6], M[:6, 6:])
        t3 = now()
        lapack.dgesdd(coupling)
        t4 = now()
        give(H=p.H, g=p.g, C=C, l=low, u=up, **options)
        qp.solve(start, None, z)
        t5 = now()
        alpha_and_more, z = np.array(qp.results.x), np.array(qp.results.z)
        assert qp.results.info.status == proxqp.PROXQP_SOLVED
        rows.append((t1 - t0, t2 - t1, t3 - t2, t4 - t3, t5 - t4))
    return 1e-3 * np.array(rows, dtype=np.float64)


def _parts(task: Task) -> FloatArray:
    """Return the times of the parts of each `Stepper.step` and of its remainder, (N, parts + 1) [us]."""
    spent, now = [0] * len(PARTS), time.perf_counter_ns

    def timed(part: int, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            begin = now()
            result = function(*arguments, **named)
            spent[part] += now() - begin
            return result

        return call

    planner, found = _stepper(task.sms), []
    planner.reset(task.side)
    with ExitStack() as stack:
        for part, (place, names) in enumerate(PARTS.values()):
            for name in names:
                stack.enter_context(mock.patch.object(place, name, timed(part, getattr(place, name))))
        for q, rates, left in task.states:
            spent[:] = [0] * len(PARTS)
            begin = now()
            planner.step(q, rates, task.target, left)
            whole = now() - begin
            found.append([*spent, whole - sum(spent)])
    return 1e-3 * np.array(found)


def report(results: dict[str, Any]) -> str:
    """Return the tables as Markdown."""
    lines = ["| model | " + " | ".join(f"{call} [us]" for call in CALLS) + " | floor [us] |"]
    lines.append("|" + "---|" * (len(CALLS) + 2))
    for name, r in results.items():
        calls = " | ".join(f"{r['calls'][call]:.1f}" for call in CALLS)
        lines.append(f"| `{name}` | {calls} | {r['floor']:.1f} |")
    lines.append("")
    lines.append(
        "| model | step, median [us] | step / floor | 99.9th percentile [us] | percentile / median | steps |"
    )
    lines.append("|" + "---|" * 6)
    lines += [
        f"| `{name}` | {r['step']:.1f} | {r['ratio']:.2f} | {r['step_p999']:.1f} | {r['tail']:.2f} | "
        f"{r['steps']} |"
        for name, r in results.items()
    ]
    lines += ["", "| part of a step [us] | " + " | ".join(f"`{name}`" for name in results) + " |"]
    lines.append("|" + "---|" * (len(results) + 1))
    for part in (*PARTS, REST):
        values = " | ".join(f"{r['parts'][part]:.1f}" for r in results.values())
        lines.append(f"| {part} | {values} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(report(run()))
