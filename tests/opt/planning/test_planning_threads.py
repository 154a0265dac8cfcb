"""A robot, its states, problems and plans in several threads give the bits of a single thread."""

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
from ffsms_pin.opt.step.stepper import StepSolver
from ffsms_pin.threads import InUse

THREADS = 3
QUICK = opt.SearchOptions(time_limit=1e-9)  # returns the first plan
METHODS = ("horizon", "step", "paper", "least-disturbance")


@pytest.fixture(autouse=True)
def short_switch_interval() -> Iterator[None]:
    """Switch between threads every few microseconds."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def run_in_threads(work: Callable[[int], Any]) -> list[Any]:
    """Return the results of `work(0)`, `work(1)`, ... in threads that begin at the same moment."""
    begin = Barrier(THREADS)

    def run(index: int) -> Any:
        begin.wait()
        return work(index)

    with ThreadPoolExecutor(THREADS) as pool:
        return list(pool.map(run, range(THREADS)))


def array_bits(result: Any) -> list[bytes]:
    """Return the bytes of all arrays of a trajectory or a recording."""
    arrays = (getattr(result, field.name) for field in fields(result))
    return [array.tobytes() for array in arrays if isinstance(array, np.ndarray)]


@pytest.fixture(scope="module")
def arm7() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


def reach(
    sms: ffsms.SpaceManipulator,
    displacement: Any,
    duration: float = 2.0,
    dt: float = 0.1,
    collision: str = "auto",
) -> opt.Problem:
    """Return a problem of a short move of the end effector by `displacement`."""
    posture = [0.4, 0.7, -0.5] if sms.n == 3 else [0.0, -0.4, 0.0, -1.8, 0.0, 1.5, 0.7]
    q0 = sms.configuration(posture)
    target = sms.at(q0).end_effector_pose.translation + displacement
    limits = [opt.JointLimits(), opt.Clearance(collision=collision)]
    return opt.Problem(sms, q0, target, duration, dt, limits=limits)


@pytest.mark.parametrize("method", METHODS)
def test_one_problem_in_several_threads(planar: ffsms.SpaceManipulator, method: str) -> None:
    single = plan_problem(reach(planar, [-0.1, 0.1, 0.0]), method, QUICK)
    problem = reach(planar, [-0.1, 0.1, 0.0])  # nothing is computed yet
    for result in run_in_threads(lambda _: plan_problem(problem, method, QUICK)):
        assert array_bits(result) == array_bits(single)


def test_one_problem_with_shapes_in_several_threads(arm7: ffsms.SpaceManipulator) -> None:
    problem = reach(arm7, [0.05, 0.05, -0.05], collision="hulls")
    single = opt.solve(problem, QUICK)
    assert single.reached
    for result in run_in_threads(lambda _: opt.solve(problem, QUICK)):
        assert array_bits(result) == array_bits(single)


def test_different_problems_of_one_robot_in_several_threads(planar: ffsms.SpaceManipulator) -> None:
    displacements = [[-0.1, 0.1, 0.0], [-0.05, -0.1, 0.0], [-0.2, 0.05, 0.0]]
    single = [array_bits(opt.solve(reach(planar, displacement), QUICK)) for displacement in displacements]
    assert run_in_threads(lambda i: array_bits(opt.solve(reach(planar, displacements[i]), QUICK))) == single


def test_a_new_robot_builds_its_shapes_in_several_threads() -> None:
    """Shapes, convex parts and buffers are made at first use, here by all threads at once."""
    single = reach(ffsms.load("satellite_panda"), [0.05, 0.0, 0.0], collision="hulls")
    names = single.limits[1]._stacks[0].names  # type: ignore[attr-defined]
    sms = ffsms.load("satellite_panda")
    for problem in run_in_threads(lambda _: reach(sms, [0.05, 0.0, 0.0], collision="hulls")):
        assert problem.limits[1]._stacks[0].names == names
        assert problem.q0.tobytes() == single.q0.tobytes()


def test_one_state_in_several_threads(arm7: ffsms.SpaceManipulator) -> None:
    q = arm7.configuration(np.full(7, 0.3))
    v = arm7.velocity(q, np.full(7, 0.1), np.full(6, 0.2))
    single = quantities(arm7.at(q, v))
    for _ in range(20):
        state = arm7.at(q, v)
        # Each thread begins with another quantity.
        for result in run_in_threads(partial(_quantities_from, state)):
            for name in ARRAYS:
                np.testing.assert_array_equal(result[name], single[name], err_msg=name)


def _quantities_from(state: ffsms.State, index: int) -> dict[str, Any]:
    return quantities(state, ARRAYS[index::THREADS] + ARRAYS)


def test_one_plan_simulated_in_several_threads(planar: ffsms.SpaceManipulator) -> None:
    plan = opt.solve(reach(planar, [-0.1, 0.1, 0.0]), QUICK)
    law = ffsms.SlidingModeController(planar)
    single = ffsms.simulate(planar, plan, law, dt=0.02)
    for result in run_in_threads(lambda _: ffsms.simulate(planar, plan, law, dt=0.02)):
        assert array_bits(result) == array_bits(single)


def test_one_problem_replanned_in_several_threads(planar: ffsms.SpaceManipulator) -> None:
    """Each thread has a reference of its own; the problem, its limits and the robot are the same."""
    problem = reach(planar, [-0.1, 0.1, 0.0])
    law, plan = ffsms.SlidingModeController(planar), opt.solve(problem, QUICK)

    def run(_: int) -> list[bytes]:
        reference = opt.Replanning(problem, plan=plan)
        return array_bits(ffsms.simulate(planar, reference, law, dt=0.02, q0=problem.q0))

    single = run(0)
    assert run_in_threads(run) == [single] * THREADS


def test_a_second_thread_may_not_continue_a_replanned_motion(
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
        pool.submit(copied.observe, 0.1, problem.q0, still).result()  # a copy is independent
    reference.observe(0.1, problem.q0, still)
    for first, other in zip(reference.sample(0.2), copied.sample(0.2), strict=True):
        np.testing.assert_array_equal(first, other)


def test_steps_of_one_planner_in_several_threads_are_correct(planar: ffsms.SpaceManipulator) -> None:
    """Concurrent calls may be refused; all completed steps are correct."""
    q0, target, rates = planar.configuration([0.4, 0.7, -0.5]), np.array([0.7, 0.5, 0.0]), np.zeros(3)
    planner = opt.StepPlanner(planar)
    planner.step(q0, rates, target, 5.0)
    expected = planner.step(q0, rates, target, 5.0).joint_rates  # with a warm start

    def step(_: int) -> list[Any]:
        outcomes: list[Any] = []
        for _ in range(100):
            try:
                outcomes.append(planner.step(q0, rates, target, 5.0).joint_rates)
            except InUse as refused:
                outcomes.append(refused)
        return outcomes

    attempts = [attempt for outcomes in run_in_threads(step) for attempt in outcomes]
    steps = [attempt for attempt in attempts if not isinstance(attempt, InUse)]
    assert steps
    for joint_rates in steps:
        np.testing.assert_allclose(joint_rates, expected, rtol=0.0, atol=1e-9)


def test_a_step_during_a_step_of_the_same_planner_is_refused(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    q0, target = planar.configuration([0.4, 0.7, -0.5]), np.array([0.7, 0.5, 0.0])
    planner, solve = opt.StepPlanner(planar), StepSolver.solve

    def with_another_step(solver: StepSolver, qp: Any, start: Any) -> Any:
        with ThreadPoolExecutor(1) as pool, pytest.raises(InUse):
            pool.submit(planner.step, q0, np.zeros(3), target, 5.0).result()
        return solve(solver, qp, start)

    monkeypatch.setattr(StepSolver, "solve", with_another_step)
    assert planner.step(q0, np.zeros(3), target, 5.0).solved
