"""Steps: their cost, every limit with and without its rows, braking, starts, threads, and the same bits."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from step_parts import StepClearance, StepJoints, StepRows, make_stepper, marched

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.limit import Rows
from ffsms_pin.opt.limits.points import Points
from ffsms_pin.opt.limits.rate_bounds import rate_bounds
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.step.march import start_sides
from ffsms_pin.opt.step.programme import StepWeights
from ffsms_pin.opt.step.state import step_state
from ffsms_pin.opt.step.stepper import Stepper, StepperInUse
from ffsms_pin.opt.terms.cost import step_cost
from ffsms_pin.system.base_motion import roll_out

TARGET = np.array([0.45, 0.75, 0.0])


def random_state(sms: ffsms.SpaceManipulator, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    q = sms.configuration(rng.uniform(0.5 * sms.limits.lower, 0.5 * sms.limits.upper))
    return q, rng.uniform(-0.3, 0.3, sms.n)


def path(
    sms: ffsms.SpaceManipulator, q0: FloatArray, rates: FloatArray, dt: float, momentum: Any = None
) -> FloatArray:
    return roll_out(sms, q0, rates[0], np.diff(rates, axis=0) / dt, dt, momentum)[0]


def missed(sms: ffsms.SpaceManipulator, q: FloatArray, target: FloatArray) -> float:
    return float(np.linalg.norm(sms.at(q).end_effector_pose.translation - target))


# -- the cost ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kappa", [1.0, 10.0, 1000.0])
def test_the_cost_of_an_unhindered_step_is_zero(planar: ffsms.SpaceManipulator, kappa: float) -> None:
    q, rates, stepper = planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), make_stepper(planar, kappa=kappa)
    for k in range(50):  # speeding up, the acceleration limits have a say
        rates = stepper.step(q, rates, TARGET, 12.0 - 0.01 * k).joint_rates
    step = stepper.step(q, rates, TARGET, 11.5)
    # Where the cost is steep, what the speed weighs beside the direction shows a little.
    assert step.cost < (1e-6 if kappa == 1.0 else 1e-9)
    assert step.cost == pytest.approx(step_cost(step.cos_theta, step.entropy, kappa))
    state = planar.at(q)
    towards = TARGET - state.end_effector_pose.translation
    assert step.cos_theta == pytest.approx(state.coupling.assistance(step.joint_rates, towards), abs=1e-9)
    assert step.entropy == pytest.approx(state.coupling.entropy, abs=1e-12)
    np.testing.assert_allclose(
        step_state(planar, q, rates, 0.01, 1.0).V @ step.alpha, step.joint_rates, atol=1e-12
    )


def test_at_the_target_the_arm_stays(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.4, 0.7, -0.5])
    here = planar.at(q).end_effector_pose.translation
    step = make_stepper(planar).step(q, np.zeros(3), here, 1.0)
    np.testing.assert_allclose(step.joint_rates, 0.0, atol=1e-6)
    assert step.cos_theta == 0.0


@pytest.mark.parametrize("reference", ["resolved-rate", "least-disturbance", "minimum-effort"])
def test_classical_references_go_straight(reference: str) -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    start = sms.at(q0).end_effector_pose.translation
    way = np.array([-0.1, 0.2, 0.15])
    stepper = make_stepper(sms, 0.02, reference=reference)
    q = path(sms, q0, marched(stepper, q0, start + way, 6.0).rates, 0.02)
    places = np.array([sms.at(row).end_effector_pose.translation for row in q[::10]]) - start
    across = places - np.outer(places @ way, way) / (way @ way)
    assert np.abs(across).max() < 2e-3
    assert missed(sms, q[-1], start + way) < 1e-3


def test_the_references_differ_in_what_they_spare() -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.2, 0.15])
    turn = {}
    for reference in ("resolved-rate", "least-disturbance"):
        q = path(sms, q0, marched(make_stepper(sms, 0.02, reference=reference), q0, target, 6.0).rates, 0.02)
        turn[reference] = np.linalg.norm(pin.log3(pin.XYZQUATToSE3(q[-1, :7]).rotation))
    assert turn["least-disturbance"] < 0.85 * turn["resolved-rate"]


# -- marches -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda", "satellite_xarm7"])
def test_marches_arrive_within_all_limits(name: str) -> None:
    """The paper's Case 2, and reaches of similar size with arms of seven joints."""
    sms, dt = ffsms.load(name), 0.02
    middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * (sms.limits.upper - sms.limits.lower)
    if name == "planar_3r":
        q0, target, duration = sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), TARGET, 12.0
    else:
        q0, duration = sms.configuration(middle), 8.0
        goal = middle + 0.2 * half * np.random.default_rng(1).uniform(-1.0, 1.0, sms.n)
        target = sms.at(sms.configuration(goal)).end_effector_pose.translation.copy()
    stepper = make_stepper(sms, dt)
    stepper.reset(start_sides(sms, q0, target)[0])
    done = marched(stepper, q0, target, duration)
    assert done.note == ""
    q = path(sms, q0, done.rates, dt)
    assert missed(sms, q[-1], target) < 1e-3
    joints = np.array([sms.layout.positions(row) for row in q])
    accelerations = np.diff(done.rates, axis=0) / dt
    assert (joints >= sms.limits.lower).all()
    assert (joints <= sms.limits.upper).all()
    assert (np.abs(done.rates) <= sms.limits.velocity).all()
    assert (np.abs(accelerations) <= sms.limits.acceleration * (1.0 + 1e-12)).all()
    assert min(Points(sms).values(row).min() for row in q) >= 0.01 - 1e-9


def loosened(sms: ffsms.SpaceManipulator, **changes: FloatArray) -> ffsms.SpaceManipulator:
    free = ffsms.SpaceManipulator(sms.model, sms.end_effector, sms.base_size)
    free.limits = dataclasses.replace(sms.limits, **changes)
    return free


@pytest.mark.parametrize("limit", ["velocity", "acceleration", "position"])
def test_a_joint_limit_holds_with_its_rows_and_breaks_without(
    planar: ffsms.SpaceManipulator, limit: str
) -> None:
    infinite = np.full(3, np.inf)
    changes = {
        "velocity": {"velocity": infinite},
        "acceleration": {"acceleration": 100.0 * planar.limits.acceleration},
        "position": {"lower": -infinite, "upper": infinite},
    }[limit]
    bound = planar.limits.upper if limit == "position" else getattr(planar.limits, limit)
    start = planar.configuration(np.deg2rad([60.0, 30.0, -10.0]))
    target, duration = TARGET, 4.0
    if limit == "position":  # where the arm would be with its first joint 24 degrees beyond the limit
        beyond = planar.configuration(np.deg2rad([105.0, 30.0, -10.0]))
        target = planar.at(beyond).end_effector_pose.translation

    def worst(sms: ffsms.SpaceManipulator) -> FloatArray:
        done = marched(make_stepper(sms, collision="off"), start, target, duration)
        joints = np.array([sms.layout.positions(q) for q in path(sms, start, done.rates, 0.01)])
        values = {"velocity": done.rates, "acceleration": np.diff(done.rates, axis=0) / 0.01}
        return np.asarray(np.abs({**values, "position": joints}[limit]).max(axis=0))

    assert (worst(planar) <= bound + 1e-9).all()
    assert (worst(loosened(planar, **changes)) > bound + 1e-3).any()


@pytest.mark.parametrize("case", ["into the base", "onto itself"])
@pytest.mark.parametrize("mode", ["points", "shapes"])
def test_clearances_are_kept_with_their_rows_and_lost_without(
    planar: ffsms.SpaceManipulator, case: str, mode: str
) -> None:
    degrees, goal = (
        ([75.0, 60.0, 20.0], [0.1, 0.15, 0.0])
        if case == "into the base"
        else (
            [0.0, 70.0, 70.0],
            [0.232, 0.0, 0.0],
        )
    )
    start = planar.configuration(np.deg2rad(degrees))
    target = planar.at(start).base_pose.act(np.array(goal))
    model: Any = StepClearance(0.01, mode).for_robot(planar)._model

    def least(collision: str) -> float:
        done = marched(make_stepper(planar, 0.02, collision=collision), start, target, 6.0)
        return min(float(model.values(q).min()) for q in path(planar, start, done.rates, 0.02))

    assert least(mode) >= 0.01 - 1e-6
    assert least("off") < 0.01


@pytest.mark.parametrize("name", ["planar_3r", "satellite_xarm7"])
def test_momentum_is_reckoned_with(name: str) -> None:
    sms, dt = ffsms.load(name), 0.02
    planar = sms.n == 3
    base = None if planar else pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    q0 = sms.configuration([0.3, 0.6, 0.5] if planar else [0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1], base)
    state = sms.at(q0)
    spin = np.array([0.0, 0.0, 0.018]) if planar else np.array([0.008, -0.01, 0.012])
    drift = np.array([0.006, -0.005, 0.0 if planar else 0.004])
    momentum = np.concatenate([state.H[0, 0] * drift, state.H[3:6, 3:6] @ spin])
    way = np.array([-0.2, 0.15, 0.0]) if planar else state.base_pose.rotation @ np.array([-0.1, 0.2, 0.15])
    target = state.end_effector_pose.translation + way
    for known, near, far in ((momentum, 0.0, 2e-3), (None, 0.03, 1.0)):
        stepper = make_stepper(sms, dt, momentum=known)
        stepper.reset(start_sides(sms, q0, target)[0])
        done = marched(stepper, q0, target, 8.0)
        # One that knows nothing of the momentum misses by centimetres.
        assert near <= missed(sms, path(sms, q0, done.rates, dt, momentum)[-1], target) < far


def test_a_pose_is_reached_with_momentum() -> None:
    sms, dt = ffsms.load("satellite_xarm7"), 0.02
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    pose = sms.at(q0).end_effector_pose.copy()
    pose.translation = pose.translation + np.array([-0.1, 0.15, 0.05])
    pose.rotation = pose.rotation @ pin.rpy.rpyToMatrix(0.2, -0.1, 0.3)
    momentum = np.array([0.5, -0.4, 0.3, 0.2, -0.3, 0.3])
    left = []
    for rotation in (pose.rotation, None):
        done = marched(make_stepper(sms, dt, momentum=momentum), q0, pose.translation, 8.0, rotation)
        q = path(sms, q0, done.rates, dt, momentum)[-1]
        assert missed(sms, q, pose.translation) < 2e-3
        left.append(float(np.linalg.norm(pin.log3(pose.rotation.T @ sms.at(q).end_effector_pose.rotation))))
    assert left[0] < 5e-3
    assert left[1] > 0.05


# -- starts, failure, threads --------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["joint limit", "into the base", "panda"])
def test_steps_from_the_last_solution_are_those_from_nothing(case: str) -> None:
    """To rounding; and the solver needs fewer iterations for them."""
    sms = ffsms.load("satellite_panda" if case == "panda" else "planar_3r")
    if case == "panda":
        middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * sms.limits.upper
        q = sms.configuration(middle)
        goal = middle + 0.5 * half * np.random.default_rng(0).uniform(-1.0, 1.0, sms.n)
        target, duration = sms.at(sms.configuration(goal)).end_effector_pose.translation.copy(), 3.0
    elif case == "joint limit":
        q = sms.configuration(np.deg2rad([60.0, 30.0, -10.0]))
        beyond = sms.configuration(np.deg2rad([105.0, 30.0, -10.0]))
        target, duration = sms.at(beyond).end_effector_pose.translation, 4.0
    else:
        q = sms.configuration(np.deg2rad([75.0, 60.0, 20.0]))
        target, duration = sms.at(q).base_pose.act(np.array([0.1, 0.15, 0.0])), 4.0
    stepper, fresh = make_stepper(sms, 0.02), make_stepper(sms, 0.02)
    rates, iterations = np.zeros(sms.n), []
    for k in range(round(duration / 0.02)):
        fresh.reset(stepper.side)
        arguments = (q, rates, target, duration - 0.02 * k)
        step, expected = stepper.advance(*arguments), fresh.advance(*arguments)
        assert step.solved
        assert expected.solved
        np.testing.assert_allclose(step.joint_rates, expected.joint_rates, rtol=0.0, atol=1e-9)
        iterations.append((stepper._solver.iterations, fresh._solver.iterations))
        q, _ = roll_out(sms, q, rates, (step.joint_rates - rates)[None] / 0.02, 0.02)
        q, rates = q[-1], step.joint_rates
    warm, cold = np.mean(iterations, axis=0)
    assert warm < 0.75 * cold


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_where_nothing_is_possible_the_arm_brakes_within_its_limits_and_says_so(name: str) -> None:
    """A limit that contradicts itself."""
    sms = ffsms.load(name)
    middle = 0.5 * (sms.limits.upper + sms.limits.lower)
    q, rates = sms.configuration(middle), 0.05 * sms.limits.velocity * np.linspace(-1.0, 1.0, sms.n)

    def contradiction(step: StepState) -> Rows:
        return Rows(np.vstack([step.J_star[:1]] * 2), np.array([0.9, -1.0]), np.array([1.0, -0.9]))

    stepper = Stepper(sms, 0.01, 10.0, [StepJoints(), StepRows(contradiction)])
    done = marched(stepper, q, TARGET, 0.05)
    assert done.note == "the arm braked in 5 of 5 steps whose programme was not solved"
    for _ in range(12):
        step = stepper.step(q, rates, TARGET, 5.0)
        assert not step.solved
        change = np.abs(step.joint_rates - rates)
        assert (change <= 0.01 * sms.limits.acceleration + 1e-15).all()
        if rates.any():
            # All joints in the same time: the rates keep their proportion, and the first joint does its most.
            np.testing.assert_allclose(
                step.joint_rates * np.abs(rates).max(), rates * np.abs(step.joint_rates).max()
            )
            assert (change / (0.01 * sms.limits.acceleration)).max() == pytest.approx(
                1.0
            ) or not step.joint_rates.any()
        assert np.isfinite(step.cost)
        rates = step.joint_rates
    assert not rates.any()
    # The next step that has a solution finds it.
    stepper.limits = stepper.limits[:1]
    assert stepper.step(q, rates, TARGET, 5.0).solved


def test_a_stepper_in_two_threads_is_refused(planar: ffsms.SpaceManipulator) -> None:
    entered, leave = threading.Event(), threading.Event()

    def waiting(step: StepState) -> None:
        entered.set()
        assert leave.wait(10.0)

    stepper = Stepper(planar, 0.01, 10.0, [StepJoints(), StepRows(waiting)])
    q, rates = random_state(planar, 1)
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(stepper.step(q, rates, TARGET, 5.0)))
    thread.start()
    assert entered.wait(10.0)
    for call in (stepper.step, stepper.build):
        with pytest.raises(StepperInUse, match=r"stepper.like\(\)") as caught:
            call(q, rates, TARGET, 5.0)
        assert isinstance(caught.value, FfsmsError)
    leave.set()
    thread.join()
    assert results[0].solved
    # The refusal has changed nothing, and the stepper works on; one of its own works in another thread.
    expected = Stepper(planar, 0.01, 10.0, [StepJoints()]).step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(results[0].joint_rates, expected.joint_rates)
    assert stepper.step(q, rates, TARGET, 5.0).solved
    assert stepper.like()._lock is not stepper._lock


_BITS = """
import hashlib
import numpy as np
from step_parts import make_stepper, marched
import ffsms_pin as ffsms
padding = [np.empty(size) for size in range(1, {padding})]  # memory lies elsewhere
digest = hashlib.sha256()
for name, way in (("planar_3r", [-0.3, 0.3, 0.0]), ("satellite_panda", [-0.2, 0.3, 0.1])):
    sms = ffsms.load(name)
    q = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper) + 0.1)
    target = sms.at(q).end_effector_pose.translation + np.array(way)
    digest.update(marched(make_stepper(sms), q, target, 3.0).rates.tobytes())
print(digest.hexdigest())
"""


def test_processes_give_the_same_bits() -> None:
    tests = Path(__file__).parents[2]
    code = f"import sys; sys.path[:0] = [{str(tests)!r}, {str(tests.parent)!r}]\n" + _BITS
    found = {
        subprocess.run(
            [sys.executable, "-c", code.format(padding=padding)], capture_output=True, text=True, check=True
        ).stdout
        for padding in (2, 1777)
    }
    assert len(found) == 1


# -- what other parts of the library use ---------------------------------------------------------------


def test_preferred_rates_are_taken_as_far_as_the_limits_allow(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    stepper = make_stepper(planar, collision="off")
    lower, upper = rate_bounds(planar.layout.positions(q), rates, planar.limits, stepper.dt)
    inside = 0.3 * lower + 0.7 * upper
    step = stepper.advance(q, rates, TARGET, 5.0, prefer=inside)
    np.testing.assert_allclose(step.joint_rates, inside, rtol=0.0, atol=1e-9)
    outside = np.array([5.0, -5.0, inside[2]])
    step = stepper.advance(q, rates, TARGET, 5.0, prefer=outside)
    np.testing.assert_allclose(step.joint_rates, np.clip(outside, lower, upper), rtol=0.0, atol=1e-9)
    # The step's own objective is back in the next one.
    np.testing.assert_allclose(
        stepper.step(q, rates, TARGET, 5.0).joint_rates,
        make_stepper(planar, collision="off").step(q, rates, TARGET, 5.0).joint_rates,
        rtol=0.0,
        atol=1e-12,
    )


def test_a_stepper_like_another_keeps_its_settings(planar: ffsms.SpaceManipulator) -> None:
    weights, limits = StepWeights(change=1e-4), [StepJoints(), AlphaBox()]
    stepper = Stepper(planar, 0.02, 5.0, limits, (), weights, "resolved-rate", np.ones(6))
    same, other = stepper.like(), stepper.like(dt=0.1, reference="step")
    for made in (same, other):
        assert (made.sms, made.kappa, made.weights) == (planar, 5.0, weights)
        assert [type(limit) for limit in made.limits] == [StepJoints, AlphaBox]
        assert made.momentum is not None
        assert made.momentum.tolist() == [1.0] * 6
    assert (same.dt, same.reference, other.dt, other.reference) == (0.02, "resolved-rate", 0.1, "step")
    assert stepper.like(sms=ffsms.load("satellite_panda")).sms.n == 7


def test_another_step_length_is_that_of_another_stepper(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 2)
    stepper = make_stepper(planar, 0.01)
    stepper.dt = 0.05
    expected = make_stepper(planar, 0.05).step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(stepper.step(q, rates, TARGET, 5.0).joint_rates, expected.joint_rates)


def test_a_copied_stepper_goes_on_as_the_first(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    stepper = make_stepper(planar)
    stepper.reset([0.0, -1.0, 0.0])
    stepper.step(q, rates, TARGET, 5.0)
    copies = [copy.deepcopy(stepper), pickle.loads(pickle.dumps(stepper))]
    other, later = random_state(planar, 4)
    expected = stepper.step(other, later, TARGET, 4.0)
    for made in copies:
        np.testing.assert_array_equal(made.step(other, later, TARGET, 4.0).joint_rates, expected.joint_rates)
        built = zip(made.build(q, rates, TARGET, 5.0), stepper.build(q, rates, TARGET, 5.0), strict=True)
        assert all(np.array_equal(a, b) for a, b in built)


def test_a_step_is_deterministic(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    first, second = (make_stepper(planar).step(q, rates, TARGET, 5.0) for _ in range(2))
    np.testing.assert_array_equal(first.joint_rates, second.joint_rates)


def test_arguments_of_any_kind_give_the_same_step(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    expected = make_stepper(planar).step(q, rates, TARGET, 5.0).joint_rates
    strided = np.zeros((planar.n, 2))
    strided[:, 0] = rates
    pose = pin.SE3(planar.at(q).end_effector_pose.rotation, TARGET)
    for arguments in (
        (q.tolist(), rates.tolist(), TARGET.tolist(), 5),
        (q, strided[:, 0], TARGET, np.float64(5.0)),
    ):
        found = make_stepper(planar).step(*arguments).joint_rates
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    assert make_stepper(planar).step(q, rates, pose, 5.0).solved


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"q": np.zeros(9)}, "q"),
        ({"q": np.zeros(10)}, "quaternion"),
        ({"joint_rates": [0.0, np.nan, 0.0]}, "joint_rates"),
        ({"target": [1.0, 2.0]}, "target"),
        ({"time_left": "soon"}, "time_left"),
    ],
)
def test_bad_arguments_are_named(
    planar: ffsms.SpaceManipulator, change: dict[str, object], name: str
) -> None:
    arguments: dict[str, Any] = {"q": planar.configuration([0, 0, 0]), "joint_rates": np.zeros(3)}
    arguments |= {"target": TARGET, "time_left": 1.0} | change
    for call in (make_stepper(planar).step, make_stepper(planar).build):
        with pytest.raises(InvalidValue, match=name):
            call(**arguments)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"dt": 0.0}, "dt"),
        ({"kappa": -1.0}, "kappa"),
        ({"reference": "fast"}, "reference"),
        ({"momentum": [1.0]}, "momentum"),
    ],
)
def test_bad_settings_are_named(planar: ffsms.SpaceManipulator, change: dict[str, Any], name: str) -> None:
    settings = {"dt": 0.01, "kappa": 10.0, "limits": []} | change
    with pytest.raises(InvalidValue, match=name):
        Stepper(planar, **settings)
