"""The default planner reaches feasible targets, reproducibly, and reports why it misses others."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from clearances_at import Points
from horizon_parts import check

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.robot.base_motion import roll_out

START = np.deg2rad([1.0, 1.0, 1.0])
SEED = 42


def targets(sms: ffsms.SpaceManipulator, count: int) -> list[tuple[FloatArray, float]]:
    """Return end positions and durations of collision-free straight joint moves of the floating robot."""
    rng, limits, points = np.random.default_rng(SEED), sms.limits, Points(sms)
    results: list[tuple[FloatArray, float]] = []
    while len(results) < count:
        move = rng.uniform(0.9 * limits.lower, 0.9 * limits.upper) - START
        q, _ = roll_out(sms, sms.configuration(START), move, np.zeros((100, 3)), 0.01)
        if min(float(points.values(row).min()) for row in q) < 0.01:
            continue
        least = np.max(np.abs(move) / limits.velocity + limits.velocity / limits.acceleration)
        target = sms.at(q[-1]).end_effector_pose.translation.copy()
        results.append((target, float(np.round(1.5 * least, 2))))
    return results


@pytest.mark.parametrize("index", range(12))
def test_targets_reachable_by_construction_are_reached(planar: ffsms.SpaceManipulator, index: int) -> None:
    target, duration = targets(planar, 12)[index]
    plan = opt.plan(planar, planar.configuration(START), target, duration)
    check(planar, plan)
    assert plan.cost_integral < 0.35
    # The rates of a joint rarely change sign.
    turns = int(np.sum(plan.joint_rates[1:-1] * plan.joint_rates[2:] < -1e-8))
    assert turns <= 24


@pytest.mark.parametrize("index", range(3))
def test_targets_are_reached_with_kappa_1(planar: ffsms.SpaceManipulator, index: int) -> None:
    target, duration = targets(planar, 3)[index]
    check(planar, opt.plan(planar, planar.configuration(START), target, duration, kappa=1.0))


def test_targets_are_reached_with_shapes_and_as_poses(planar: ffsms.SpaceManipulator) -> None:
    q0, target = planar.configuration([0.4, 0.7, -0.5]), np.array([0.75, 0.5, 0.0])
    plan = opt.plan(planar, q0, target, 6.0, 0.02, collision="shapes")
    assert plan.reached
    assert plan.cost_integral < 1e-2
    pose = planar.at(plan.q[-1]).end_effector_pose
    posed = opt.plan(planar, q0, pose, 6.0, 0.02)
    assert posed.reached
    assert posed.orientation_error[-1] < 1e-3
    assert posed.position_error[-1] < 2e-3


def test_arms_with_seven_and_continuous_joints_reach_targets(planar: ffsms.SpaceManipulator) -> None:
    """The target is the end of a straight joint move."""
    for name, move in (("satellite_xarm7", 0.4), ("satellite_kinova", 0.4)):
        sms = ffsms.load(name)
        lower = np.where(np.isfinite(sms.limits.lower), sms.limits.lower, -1.0)
        upper = np.where(np.isfinite(sms.limits.upper), sms.limits.upper, 1.0)
        start = 0.5 * (lower + upper) + 0.05 * (upper - lower)
        change = np.array([move * (-1.0) ** j for j in range(sms.n)])
        q, _ = roll_out(sms, sms.configuration(start), change, np.zeros((200, sms.n)), 1.0 / 200)
        target = sms.at(q[-1]).end_effector_pose.translation.copy()
        plan = opt.plan(sms, sms.configuration(start), target, 8.0, 0.04)
        assert plan.reached, plan.note
        assert plan.position_error[-1] <= 1e-3
        assert (np.abs(plan.joint_rates) <= sms.limits.velocity + 1e-12).all()
        assert np.abs(sms.at(plan.q[-1], plan.v[-1]).momentum).max() < 1e-9


def moves(sms: ffsms.SpaceManipulator, start: FloatArray, count: int) -> list[tuple[Any, float]]:
    """Return end poses and durations of collision-free straight joint moves of the floating robot."""
    rng, limits, points = np.random.default_rng(1), sms.limits, Points(sms)
    middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
    results: list[tuple[Any, float]] = []
    while len(results) < count:
        move = middle + 0.9 * half * rng.uniform(-1.0, 1.0, sms.n) - start
        q, _ = roll_out(sms, sms.configuration(start), move, np.zeros((120, sms.n)), 1.0 / 120)
        if min(float(points.values(row).min()) for row in q) < 0.01:
            continue
        least = np.max(np.abs(move) / limits.velocity + limits.velocity / limits.acceleration)
        results.append((sms.at(q[-1]).end_effector_pose, float(np.ceil(150.0 * least) / 100.0)))
    return results


# The duration of the second is short; the third pair has a base corner and a nearly singular end.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "indices"),
    [("satellite_panda", (0,)), ("satellite_panda", (15,)), ("satellite_xarm7", (25, 29))],
)
def test_poses_in_space_are_reached(name: str, indices: tuple[int, ...]) -> None:
    sms = ffsms.load(name)
    start = 0.5 * (sms.limits.lower + sms.limits.upper)
    tasks = moves(sms, start, max(indices) + 1)
    for index in indices:
        pose, duration = tasks[index]
        # The targets are reachable with clear points.
        plan = opt.plan(sms, sms.configuration(start), pose, duration, collision="points")
        check(sms, plan)
        end = sms.at(plan.q[-1]).end_effector_pose
        assert np.linalg.norm(end.translation - pose.translation) <= 1e-3
        assert np.linalg.norm(pin.log3(pose.rotation @ end.rotation.T)) <= 1e-3


@pytest.mark.parametrize("distance", [1e-4, 1e-3, 0.019])
@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_the_path_to_a_target_near_the_start_is_short(name: str, distance: float) -> None:
    sms = ffsms.load(name)
    bent = [0.4, 0.7, -0.5] if sms.n == 3 else 0.5 * (sms.limits.lower + sms.limits.upper)
    q0 = sms.configuration(bent)
    target = sms.at(q0).end_effector_pose.translation + distance * np.array([0.6, -0.8, 0.0])
    plan = opt.plan(sms, q0, target, 6.0, 0.02)
    check(sms, plan)
    assert plan.position_error[-1] <= 0.1 * distance
    length = float(np.linalg.norm(np.diff(plan.end_effector, axis=0), axis=1).sum())
    assert length <= 3.0 * distance


def test_a_small_rotation_keeps_the_position() -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    here = sms.at(q0).end_effector_pose
    plan = opt.plan(
        sms, q0, pin.SE3(pin.exp3(np.array([0.0, 0.01, 0.01])) @ here.rotation, here.translation), 4.0
    )
    assert plan.reached
    assert plan.orientation_error[-1] <= 1e-3
    assert plan.position_error.max() <= 1e-3


def plan_digest(plan: opt.Trajectory) -> str:
    arrays = (plan.q, plan.v, plan.alpha, plan.cost)
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()


def test_same_input_same_output_bit_for_bit(planar: ffsms.SpaceManipulator) -> None:
    """Compare runs in one process, with a changed heap between them, and a run in another process."""
    rng, digests = np.random.default_rng(), []
    tasks = targets(planar, 3)
    q0 = planar.configuration(START)
    for _ in range(2):
        digests.append([plan_digest(opt.plan(planar, q0, target, T, 0.02)) for target, T in tasks])
        junk = [rng.normal(size=rng.integers(1, 5000)) for _ in range(200)]
        del junk[::2]
    assert digests[0] == digests[1]
    lines = "\n".join(
        f"print(digest(opt.plan(sms, q0, np.array({[float(x).hex() for x in target]!r} and "
        f"[float.fromhex(x) for x in {[float(x).hex() for x in target]!r}]), {T!r}, 0.02)))"
        for target, T in tasks
    )
    code = (
        "import hashlib, numpy as np, ffsms_pin as ffsms\n"
        "from ffsms_pin import opt\n"
        "def digest(p):\n"
        "    return hashlib.sha256(b''.join(a.tobytes() for a in (p.q, p.v, p.alpha, p.cost))).hexdigest()\n"
        "sms = ffsms.load('planar_3r')\n"
        "junk = [np.ones(k) for k in range(1, 3000, 7)]\n"
        "q0 = sms.configuration(np.deg2rad([1.0, 1.0, 1.0]))\n" + lines
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ.copy()
    )
    assert run.stdout.split() == digests[0]


def test_the_note_of_a_target_outside_the_workspace(planar: ffsms.SpaceManipulator) -> None:
    plan = opt.plan(planar, planar.configuration(START), [3.0, 0.0, 0.0], 6.0)
    assert not plan.reached
    assert "workspace" in plan.note
    assert f"{plan.position_error[-1]:.4f} m" in plan.note
    assert plan.position_error[-1] < 1.93  # the stretched arm ends 1.904 m from it
    assert plan.shortest_duration == 0.0
    for part in ("nearest position", "binding"):
        assert part in plan.note


def test_a_duration_that_is_too_short(planar: ffsms.SpaceManipulator) -> None:
    target, duration = targets(planar, 1)[0]
    short = opt.plan(planar, planar.configuration(START), target, 0.4 * duration)
    assert not short.reached
    assert "binding" in short.note
    assert "limit of 'joint_" in short.note
    assert short.shortest_duration > short.duration
    assert f"{short.shortest_duration:.2f} s would suffice" in short.note
    # The limits hold in the failed plan, and the reported duration suffices.
    assert (np.abs(short.joint_rates) <= planar.limits.velocity + 1e-12).all()
    longer = opt.plan(planar, planar.configuration(START), target, short.shortest_duration)
    check(planar, longer)


@pytest.mark.parametrize("method", ["horizon", "step"])
def test_a_start_in_collision_is_not_reached(planar: ffsms.SpaceManipulator, method: str) -> None:
    q0 = planar.configuration([1.2, 2.4, 1.6])  # the elbow in the base
    here = planar.at(q0).end_effector_pose.translation
    plan = opt.plan(planar, q0, here, 2.0, method=method)
    assert not plan.clear
    assert not plan.reached
    if method == "horizon":
        assert "start violates the clearance" in plan.note
        assert "joint_3 - base box" in plan.note
        assert np.array_equal(plan.q, np.tile(q0, (201, 1)))
    assert opt.plan(planar, q0, here, 2.0, method=method, collision="off").clear


def test_the_note_gives_the_distance_from_a_fixed_base(planar: ffsms.SpaceManipulator) -> None:
    """The distance is from the base's centre of mass, which thrusters keep at rest."""
    q0 = planar.configuration([0.1, 0.2, 0.3])
    base = planar.at(q0).base_pose.translation
    problem = opt.Problem(planar, q0, base + np.array([6.0, 0.0, 0.0]), 6.0, 0.05, mode="flying")
    note = opt.solve(problem).note
    assert "m from the base's centre of mass and the target is 6.000 m from it" in note
