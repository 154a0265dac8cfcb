"""Steps in driven base modes: C_bm and J*, base motion, and rows for the wheels."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from mode_measures import mode_measures
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.wheel_limits import WheelLimits
from ffsms_pin.opt.plans import METHODS
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot.base_motion import advance

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
MODES = ("rotation-floating", "rotation-flying", "translation-flying", "flying")
TARGET = [0.45, 0.75, 0.0]
WHEELS = WheelLimits()  # with a margin of 8 %


def planar(**values: Any) -> ffsms.SpaceManipulator:
    """Return `planar_3r` with four wheels, by default of 0.1 N m and 1 N m s."""
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, **{"torque": 0.1, "momentum": 1.0, **values})
    return ffsms.load("planar_3r").with_actuators(wheels=wheels)


def start(sms: ffsms.SpaceManipulator) -> FloatArray:
    return sms.configuration(np.radians([1.0, 1.0, 1.0]))


def planned(sms: ffsms.SpaceManipulator, mode: str = "rotation-floating", method: str = "step") -> Any:
    return opt.plan(sms, start(sms), TARGET, 12.0, 0.05, mode=mode, method=method)


def spatial(seed: int) -> tuple[ffsms.SpaceManipulator, FloatArray, FloatArray]:
    """Return a Panda on its satellite, a random configuration and joint rates."""
    sms, rng = ffsms.load("satellite_panda"), np.random.default_rng(seed)
    joints = 0.5 * (sms.limits.lower + sms.limits.upper) + rng.uniform(-0.3, 0.3, 7)
    return sms, sms.configuration(joints, random_pose(rng)), rng.uniform(-0.3, 0.3, 7)


@pytest.mark.parametrize("mode", MODES)
def test_step_states_agree_with_the_mode(mode: str) -> None:
    for seed in range(4):
        sms, q, rates = spatial(seed)
        step, expected = StepState(sms, q, rates, 0.01, 5.0, mode=mode), mode_measures(sms.at(q), mode)
        np.testing.assert_allclose(step.J_star, expected.J_star, atol=1e-12)
        assert step.entropy == pytest.approx(expected.entropy, abs=1e-12)
        # The base twist has no driven component.
        twist = sms.at(q, np.concatenate([step.reaction @ rates, rates])).base_twist
        np.testing.assert_allclose(twist, expected.C_bm @ rates, atol=1e-12)
        assert opt.Problem(sms, q, [1.0, 0.0, 0.0], mode=mode).mode == step.mode


@pytest.mark.parametrize("mode", MODES)
def test_the_driven_base_coordinates_stay_at_rest(mode: str) -> None:
    """After 100 steps the error is due to rounding and quadrature alone."""
    sms, q, rates = spatial(5)
    before, momentum = sms.at(q), None
    if mode == "rotation-floating":
        momentum = np.array([3.0, -2.0, 1.0, 0.0, 0.0, 0.0])
    first = q
    for _ in range(100):
        q, rates = advance(sms, q, rates, np.full(7, 0.05), 0.01, momentum, mode)
    after = sms.at(q)
    displacement = after.base_pose.translation - before.base_pose.translation
    rotation = pin.log3(before.base_pose.rotation.T @ after.base_pose.rotation)
    if "rotation" in mode:
        assert np.linalg.norm(rotation) < 1e-12
        drift = np.zeros(3) if momentum is None else momentum[:3] / after.H_b[0, 0]
        np.testing.assert_allclose(after.com - before.com, drift, atol=1e-9)
        assert np.linalg.norm(displacement) > 1e-3
    else:
        assert np.linalg.norm(displacement) < 1e-9
        assert (np.linalg.norm(rotation) > 1e-3) == (mode == "translation-flying")
    assert not np.array_equal(first[7:], q[7:])


@pytest.mark.parametrize("quantity", ["momentum", "torque"])
def test_rows_bound_the_wheels_at_the_end_of_the_step(quantity: str) -> None:
    """A step to the bound of a row brings the wheel to its limit, by Pinocchio's centroidal momentum."""
    bare, q, rates = spatial(7)
    axes, mode, dt = ffsms.ReactionWheels(PYRAMID, 0.02).axes, "rotation-floating", 1e-3
    total, data = np.array([0.1, -0.2, 0.05, 0.3]), bare.model.createData()

    def momentum(q: FloatArray, rates: FloatArray) -> FloatArray:
        """Return the wheels' momenta: the total without the momentum of arm and base."""
        v = bare.velocity(q, rates, None, mode)
        arm_momentum = pin.computeCentroidalMomentum(bare.model, data, q, v).angular
        return np.asarray(total - np.linalg.pinv(axes.T) @ pin.XYZQUATToSE3(q[:7]).rotation.T @ arm_momentum)

    now = momentum(q, rates)
    # The momentum limits are within one step.
    limit = (np.abs(now) + 5e-4) / 0.92 if quantity == "momentum" else np.full(4, 0.5)
    limits: dict[str, Any] = {quantity: limit}
    sms = bare.with_actuators(wheels=replace(ffsms.ReactionWheels(PYRAMID, 0.02), **limits))
    rows = WHEELS.rows(StepState(sms, q, rates, dt, 5.0, mode=mode, wheel_total=total))
    assert rows is not None
    for i, (row, lower, upper) in enumerate(zip(*rows[:3], strict=True)):
        # Arm and wheels exchange momentum, so the lower bound is set by the wheel's largest momentum.
        for bound, sign in ((lower, 1.0), (upper, -1.0)):
            if quantity == "momentum" and sign != np.sign(now[i]):
                continue
            u = rates + row * (bound - row @ rates)
            end, _ = advance(sms, q, rates, (u - rates) / dt, dt, None, mode)
            after = momentum(end, u)[i]
            value = after if quantity == "momentum" else (after - now[i]) / dt
            assert value == pytest.approx(sign * 0.92 * limit[i], rel=2e-3)


def test_rows_include_the_friction_of_the_wheels() -> None:
    """Friction of a spinning wheel shifts the bounds of its torque."""
    bare, q, rates = spatial(8)
    total, limits = np.full(4, 0.3), []
    for friction in (0.0, 2e-3):
        sms = bare.with_actuators(wheels=ffsms.ReactionWheels(PYRAMID, 0.02, 0.5, friction=friction))
        step = StepState(sms, q, rates, 1e-3, 5.0, mode="rotation-floating", wheel_total=total)
        rows = WHEELS.rows(step)
        assert rows is not None
        limits.append((rows.lower, rows.upper))
    (low, up), (low_with_friction, up_with_friction) = limits
    np.testing.assert_allclose(up_with_friction - low_with_friction, up - low, rtol=1e-9)
    assert np.abs(low_with_friction - low).min() > 0.0


def test_wheels_about_one_axis_share_a_row() -> None:
    """The weakest wheel sets the bound."""
    sms = planar(momentum=[1.0, 0.5, 0.3, 2.0], torque=np.inf)
    # Joint limits are inactive because they would widen the row.
    fast = np.full(3, 1e9)
    sms = sms.with_limits(replace(sms.limits, acceleration=fast, velocity=fast))
    step = StepState(sms, start(sms), np.zeros(3), 0.01, 5.0, mode="rotation-floating")
    rows = WHEELS.rows(step)
    assert rows is not None
    assert rows.G.shape == (1, 3)
    M = pin.crba(sms.model, sms.model.createData(), step.q)
    D = M[5, 6:] + M[5, :6] @ step.reaction
    share = np.linalg.pinv(sms.wheels.axes.T)[0, 2]  # type: ignore[union-attr]
    assert rows.upper[0] == pytest.approx(0.92 * 0.3 / np.linalg.norm(share * D), rel=1e-9)
    assert rows.lower[0] == pytest.approx(-rows.upper[0], rel=1e-9)


def test_wheels_that_hold_no_attitude_have_no_rows() -> None:
    sms = planar()
    for mode in ("floating", "rotation-flying"):
        assert WHEELS.rows(StepState(sms, start(sms), np.zeros(3), 0.01, 5.0, mode=mode)) is None
    bare = ffsms.load("planar_3r")
    assert WHEELS.rows(StepState(bare, start(bare), np.zeros(3), 0.01, 5.0, mode="rotation-floating")) is None


@pytest.mark.parametrize("mode", MODES)
def test_rollouts_in_a_driven_mode(mode: str) -> None:
    """The rollout of the plan is another implementation than that of the steps."""
    sms = planar()
    plan = planned(sms, mode)
    assert plan.reached, plan.note
    assert (plan.note == "") == plan.within_tolerance
    twists = np.array([sms.at(q, v).base_twist for q, v in zip(plan.q, plan.v, strict=True)])
    driven = twists[:, 3:] if "rotation" in mode else twists[:, :3] if mode != "flying" else twists
    assert np.abs(driven).max() < 1e-12
    # The entropies of the steps agree with the motion.
    entropy = [mode_measures(sms.at(q), mode).entropy for q in plan.q[:-1:40]]
    np.testing.assert_allclose(plan.entropy[::40], entropy, atol=1e-9)
    assert bool(plan.wheel_momentum.any()) == (mode == "rotation-floating")


@pytest.mark.parametrize("method", METHODS[1:])
def test_step_methods_plan_with_a_controlled_attitude(method: str) -> None:
    plan = planned(planar(torque=10.0), method=method)
    assert plan.base_rotation.max() < 1e-12
    assert plan.clear, plan.note
    assert plan.position_error[-1] < 0.01
    # The paper's method chatters and arrives late.
    assert plan.reached or method == "paper"


def test_a_floating_rollout_misses_with_a_controlled_attitude() -> None:
    """The same joint motion ends elsewhere with a controlled attitude."""
    sms = planar()
    problem = opt.Problem(sms, start(sms), TARGET, 12.0, 0.05, mode="rotation-floating")
    assert measure(problem, planned(sms, "floating").joint_rates).position_error[-1] > 0.05


def test_rows_keep_the_wheels_within_their_momentum() -> None:
    largest = np.abs(planned(planar()).wheel_momentum).max()
    sms = planar(torque=np.inf, momentum=0.7 * largest)
    plan = planned(sms)
    assert plan.reached, plan.note
    assert np.abs(plan.wheel_momentum).max() < 0.7 * largest


def test_the_note_of_a_rollout_gives_a_sufficient_wheel_momentum() -> None:
    """With 1.1 times the reported momentum the rollout arrives."""
    plan = planned(planar(torque=np.inf, momentum=0.007), method="resolved-rate")
    assert not plan.reached
    assert plan.broken == {}
    assert "the wheels would saturate: wheel 1 would need" in plan.note
    needed = float(plan.note.split("wheels of ")[1].split(" N m s would suffice")[0])
    assert 0.02 < needed < 0.05
    assert planned(planar(torque=np.inf, momentum=1.1 * needed), method="resolved-rate").reached


def test_the_step_planner_in_a_mode() -> None:
    sms, target = planar(), np.array(TARGET)
    planner = opt.StepPlanner(sms, 0.02, mode="rotation-floating", wheel_momentum=[0.1, 0.0, 0.0, 0.0])
    assert "wheels" in [limit.name for limit in planner.limits]
    rates = np.array([0.1, -0.1, 0.2])
    step = planner.step(start(sms), rates, target, 11.0)
    floating = opt.StepPlanner(sms, 0.02).step(start(sms), rates, target, 11.0)
    assert step.entropy != floating.entropy
    assert step.entropy == pytest.approx(mode_measures(sms.at(start(sms)), "rotation-floating").entropy)
    # Copies keep mode and wheel momentum.
    copies = pickle.loads(pickle.dumps(planner)), planner.like()
    for copy in copies:
        assert copy.mode == "rotation-floating"
        np.testing.assert_array_equal(copy.wheel_total, [0.1, 0.0, 0.0, 0.0])
    problem = planner.track(target, 12.0).problem
    assert problem.mode == "rotation-floating"
    np.testing.assert_array_equal(problem.wheel_momentum, [0.1, 0.0, 0.0, 0.0])
