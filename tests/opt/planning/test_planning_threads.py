"""One robot, its states, problems and plans in several threads at once: the same bits as alone."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from functools import partial
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from paper_sums import ARRAYS, quantities

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.threads import InUse

THREADS = 3
QUICK = opt.SearchOptions(time_limit=1e-9)  # the first plan is taken
METHODS = ("horizon", "step", "paper", "least-disturbance")


@pytest.fixture(autouse=True)
def hasty() -> Iterator[None]:
    """Threads that take turns every few microseconds."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def together(work: Callable[[int], Any]) -> list[Any]:
    """What `work(0)`, `work(1)`, ... give in threads that begin at the same moment."""
    begin = Barrier(THREADS)

    def run(index: int) -> Any:
        begin.wait()
        return work(index)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(run, range(THREADS)))


def bits(result: Any) -> list[bytes]:
    """The arrays of a trajectory or a recording."""
    arrays = (getattr(result, field.name) for field in fields(result))
    return [array.tobytes() for array in arrays if isinstance(array, np.ndarray)]


@pytest.fixture(scope="module")
def arm7() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


def reach(
    sms: ffsms.SpaceManipulator, way: Any, duration: float = 2.0, dt: float = 0.1, collision: str = "auto"
) -> opt.Problem:
    """A short move of the end effector by `way`."""
    posture = [0.4, 0.7, -0.5] if sms.n == 3 else [0.0, -0.4, 0.0, -1.8, 0.0, 1.5, 0.7]
    q0 = sms.configuration(posture)
    target = sms.at(q0).end_effector_pose.translation + way
    limits = [opt.JointLimits(), opt.Clearance(collision=collision)]
    return opt.Problem(sms, q0, target, duration, dt, limits=limits)


@pytest.mark.parametrize("method", METHODS)
def test_one_problem_in_several_threads(planar: ffsms.SpaceManipulator, method: str) -> None:
    alone = plan_problem(reach(planar, [-0.1, 0.1, 0.0]), method, QUICK)
    problem = reach(planar, [-0.1, 0.1, 0.0])  # nothing of it is worked out yet
    for found in together(lambda _: plan_problem(problem, method, QUICK)):
        assert bits(found) == bits(alone)


def test_one_problem_with_shapes_in_several_threads(arm7: ffsms.SpaceManipulator) -> None:
    problem = reach(arm7, [0.05, 0.05, -0.05], collision="hulls")
    alone = opt.solve(problem, QUICK)
    assert alone.reached
    for found in together(lambda _: opt.solve(problem, QUICK)):
        assert bits(found) == bits(alone)


def test_different_problems_of_one_robot_in_several_threads(planar: ffsms.SpaceManipulator) -> None:
    ways = [[-0.1, 0.1, 0.0], [-0.05, -0.1, 0.0], [-0.2, 0.05, 0.0]]
    alone = [bits(opt.solve(reach(planar, way), QUICK)) for way in ways]
    assert together(lambda i: bits(opt.solve(reach(planar, ways[i]), QUICK))) == alone


def test_a_new_robot_in_several_threads() -> None:
    """Shapes, convex parts and scratch data are made when first asked for: here by all threads at once."""
    alone = reach(ffsms.load("satellite_panda"), [0.05, 0.0, 0.0], collision="hulls")
    names = alone.limits[1]._stacks[0].names  # type: ignore[attr-defined]
    sms = ffsms.load("satellite_panda")
    for problem in together(lambda _: reach(sms, [0.05, 0.0, 0.0], collision="hulls")):
        assert problem.limits[1]._stacks[0].names == names
        assert problem.q0.tobytes() == alone.q0.tobytes()


def test_one_state_in_several_threads(arm7: ffsms.SpaceManipulator) -> None:
    q = arm7.configuration(np.full(7, 0.3))
    v = arm7.velocity(q, np.full(7, 0.1), np.full(6, 0.2))
    alone = quantities(arm7.at(q, v))
    for _ in range(20):
        state = arm7.at(q, v)
        # Each thread begins with another quantity, so that all of them are made somewhere first.
        for found in together(partial(_quantities_from, state)):
            for name in ARRAYS:
                np.testing.assert_array_equal(found[name], alone[name], err_msg=name)


def _quantities_from(state: ffsms.State, index: int) -> dict[str, Any]:
    return quantities(state, ARRAYS[index::THREADS] + ARRAYS)


def test_one_plan_followed_in_several_threads(planar: ffsms.SpaceManipulator) -> None:
    plan = opt.solve(reach(planar, [-0.1, 0.1, 0.0]), QUICK)
    law = ffsms.SlidingModeController(planar)
    alone = ffsms.simulate(planar, plan, law, dt=0.02)
    for found in together(lambda _: ffsms.simulate(planar, plan, law, dt=0.02)):
        assert bits(found) == bits(alone)


def test_planned_again_in_several_threads(planar: ffsms.SpaceManipulator) -> None:
    """Each thread has a reference of its own; the problem, its limits and the robot are the same."""
    problem = reach(planar, [-0.1, 0.1, 0.0])
    law, plan = ffsms.SlidingModeController(planar), opt.solve(problem, QUICK)

    def run(_: int) -> list[bytes]:
        reference = opt.Replanning(problem, plan=plan)
        return bits(ffsms.simulate(planar, reference, law, dt=0.02, q0=problem.q0))

    alone = run(0)
    assert together(run) == [alone] * THREADS


def test_a_second_thread_does_not_go_on_with_a_replanned_motion(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError]
) -> None:
    problem = reach(planar, [-0.1, 0.1, 0.0])
    reference = opt.Replanning(problem, plan=opt.solve(problem, QUICK))
    still = np.zeros(planar.nv)
    reference.observe(0.0, problem.q0, still)
    copied = pickle.loads(pickle.dumps(reference))
    with ThreadPoolExecutor(1) as pool:
        refused(
            lambda: pool.submit(reference.observe, 0.1, problem.q0, still).result(),
            InUse,
            "opt.Replanning(problem)",
        )
        pool.submit(copied.observe, 0.1, problem.q0, still).result()  # a copy is another one
    reference.observe(0.1, problem.q0, still)
    for one, other in zip(reference.sample(0.2), copied.sample(0.2), strict=True):
        np.testing.assert_array_equal(one, other)


def test_one_step_planner_works_or_refuses(planar: ffsms.SpaceManipulator) -> None:
    """Two threads at once are refused; a step that is taken is right."""
    q0, target, rates = planar.configuration([0.4, 0.7, -0.5]), np.array([0.7, 0.5, 0.0]), np.zeros(3)
    planner = opt.StepPlanner(planar)
    planner.step(q0, rates, target, 5.0)
    wanted = planner.step(q0, rates, target, 5.0).joint_rates  # what it goes on from stays the same now

    def step(_: int) -> list[Any]:
        found: list[Any] = []
        for _ in range(100):
            try:
                found.append(planner.step(q0, rates, target, 5.0).joint_rates)
            except InUse as refused:  # noqa: PERF203 - both are counted
                found.append(refused)
        return found

    taken = [one for found in together(step) for one in found]
    rates_taken = [one for one in taken if not isinstance(one, InUse)]
    assert len(rates_taken) < len(taken)
    assert rates_taken
    for one in rates_taken:
        np.testing.assert_allclose(one, wanted, rtol=0.0, atol=1e-9)
