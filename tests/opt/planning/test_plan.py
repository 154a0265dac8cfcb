"""`opt.plan` on the paper's two cases, and the consistency of a trajectory."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from clearances_at import Points
from scipy.integrate import solve_ivp

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.opt.step.stepper import Stepper

CASES = {"case-1": [1.00, 0.15, 0.0], "case-2": [0.45, 0.65, 0.0]}


@pytest.fixture(scope="module")
def sms() -> ffsms.SpaceManipulator:
    return ffsms.load("planar_3r")


@pytest.fixture(scope="module", params=sorted(CASES))
def trajectory(request: pytest.FixtureRequest, sms: ffsms.SpaceManipulator) -> opt.Trajectory:
    return opt.plan(sms, sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), CASES[request.param])


def test_shapes_and_ends(sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory) -> None:
    N = 1200
    shapes = {
        "t": (N + 1,),
        "q": (N + 1, sms.nq),
        "v": (N + 1, sms.nv),
        "joint_accelerations": (N, 3),
        "alpha": (N, 3),
        "cos_theta": (N,),
        "entropy": (N,),
        "cost": (N,),
        "position_error": (N + 1,),
    }
    for name, shape in shapes.items():
        array = getattr(trajectory, name)
        assert array.shape == shape
        assert not array.flags.writeable
    assert trajectory.t[0] == 0.0
    assert trajectory.t[-1] == 12.0


def test_plans_reach_the_target_and_end_at_rest(
    sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory
) -> None:
    assert trajectory.reached
    late = trajectory.t >= 0.9 * 12.0
    assert trajectory.position_error[late].max() <= 0.02
    assert trajectory.position_error[-1] <= 1e-3
    end = sms.at(trajectory.q[-1]).end_effector_pose.translation
    assert np.linalg.norm(end - trajectory.target) == pytest.approx(trajectory.position_error[-1], abs=1e-12)
    assert np.abs(trajectory.v[-1]).max() < 1e-3


def test_joint_limits_hold_at_and_between_nodes(
    sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory
) -> None:
    limits = sms.limits
    assert (np.abs(trajectory.joint_rates) <= limits.velocity + 1e-12).all()
    assert (np.abs(trajectory.joint_accelerations) <= limits.acceleration + 1e-9).all()
    for t in np.linspace(0.0, 12.0, 5003):  # not the nodes
        position, rates, _ = trajectory.sample(t)
        assert (limits.lower - 1e-12 <= position).all()
        assert (position <= limits.upper + 1e-12).all()
        assert (np.abs(rates) <= limits.velocity + 1e-12).all()
    assert (np.abs(trajectory.alpha) <= 1.0 + 1e-6).all()


def test_clearances_hold_between_nodes(sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory) -> None:
    points = Points(sms)
    for t in np.linspace(0.0, 12.0, 2503):
        position, _, _ = trajectory.sample(t)
        assert points.values(sms.configuration(position)).min() >= 0.01


def test_states_and_accelerations_of_a_plan_are_consistent(
    sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory
) -> None:
    dt = trajectory.dt
    joints, rates, acc = trajectory.q[:, 7:], trajectory.v[:, 6:], trajectory.joint_accelerations
    np.testing.assert_allclose(np.diff(rates, axis=0), dt * acc, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(
        np.diff(joints, axis=0), dt * rates[:-1] + 0.5 * dt**2 * acc, rtol=0.0, atol=1e-14
    )
    for q, v in zip(trajectory.q[::50], trajectory.v[::50], strict=True):
        assert abs(np.linalg.norm(q[3:7]) - 1.0) < 1e-14
        np.testing.assert_allclose(v, sms.velocity(q, v[6:]), rtol=0.0, atol=1e-14)
        assert np.abs(sms.at(q, v).momentum).max() < 1e-14
        assert np.abs(sms.at(q).com).max() < 1e-13  # zero momentum: the centre of mass stays


def test_the_base_follows_the_momentum_equation(
    sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory
) -> None:
    """Integrate the paper's equation, base twist = C_bm joint rates, by an adaptive integrator."""

    def twist(t: float, y: FloatArray) -> FloatArray:
        position, rates, _ = trajectory.sample(t)
        base = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, y[2]), np.array([y[0], y[1], 0.0]))
        C_bm = sms.at(sms.configuration(position, base)).C_bm
        return (C_bm @ rates)[[0, 1, 5]]

    start = trajectory.q[0]
    stop = 200  # two seconds
    base = np.array([start[0], start[1], 0.0])
    for k in range(stop):  # the accelerations jump from step to step
        span = (trajectory.t[k], trajectory.t[k + 1] - 1e-12)
        base = solve_ivp(twist, span, base, rtol=1e-11, atol=1e-13).y[:, -1]
    yaw = 2.0 * np.arctan2(trajectory.q[stop, 5], trajectory.q[stop, 6])
    np.testing.assert_allclose(base, [*trajectory.q[stop, :2], yaw], atol=1e-10)


def test_measures_of_a_plan_agree_with_its_states(
    sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory
) -> None:
    for k in range(0, 1200, 97):
        state = sms.at(trajectory.q[k])
        rates = trajectory.v[k + 1, 6:]
        towards = trajectory.target - state.end_effector_pose.translation
        assert trajectory.cos_theta[k] == pytest.approx(state.coupling.assistance(rates, towards), abs=1e-8)
        assert trajectory.entropy[k] == pytest.approx(state.coupling.entropy, abs=1e-12)
        expected = opt.step_cost(trajectory.cos_theta[k], trajectory.entropy[k], 10.0)
        assert trajectory.cost[k] == pytest.approx(expected, abs=1e-15)
        assert np.linalg.norm(trajectory.alpha[k]) == pytest.approx(np.linalg.norm(rates))


def test_the_cost_is_close_to_zero_on_both_cases(trajectory: opt.Trajectory) -> None:
    assert trajectory.cost_integral < 1e-3


def test_save_and_load(trajectory: opt.Trajectory, tmp_path: Path) -> None:
    trajectory.save(tmp_path / "trajectory.npz")
    loaded = opt.Trajectory.load(tmp_path / "trajectory.npz")
    for name, value in vars(trajectory).items():
        if name != "problem":  # files do not keep it
            np.testing.assert_equal(getattr(loaded, name), value, err_msg=name)  # NaN is itself here
    assert loaded.problem is None
    assert loaded.reached == trajectory.reached
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.npz"]


def test_load_reports_wrong_files(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="no such file"):
        opt.Trajectory.load(tmp_path / "absent.npz")
    (tmp_path / "text.npz").write_text("not a zip")
    with pytest.raises(ResultError, match="not an npz"):
        opt.Trajectory.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", t=np.zeros(3))
    with pytest.raises(ResultError, match="is not a ffsms-pin trajectory"):
        opt.Trajectory.load(tmp_path / "other.npz")


def test_same_input_same_output(sms: ffsms.SpaceManipulator) -> None:
    q0 = sms.configuration([0.4, 0.7, -0.5])
    first, second = (opt.plan(sms, q0, [0.7, 0.5, 0.0], duration=4.0, dt=0.02) for _ in range(2))
    assert np.array_equal(first.q, second.q)
    assert np.array_equal(first.alpha, second.alpha)


def test_a_plan_to_a_target_out_of_reach_is_not_reached(sms: ffsms.SpaceManipulator) -> None:
    plan = opt.plan(sms, sms.configuration([0.4, 0.7, -0.5]), [3.0, 0.0, 0.0], duration=3.0, dt=0.05)
    assert not plan.reached
    assert plan.position_error[-1] > 1.0


def test_plans_do_not_depend_on_the_inertial_axes(
    sms: ffsms.SpaceManipulator,
) -> None:
    joints, target = np.array([0.4, 0.7, -0.5]), np.array([0.75, 0.5, 0.0])
    turn = pin.SE3(pin.utils.rotate("x", 0.7) @ pin.utils.rotate("z", 1.1), np.array([1.0, -2.0, 0.5]))
    q0 = sms.configuration(joints)
    q1 = sms.configuration(joints, turn * pin.XYZQUATToSE3(q0[:7]))
    plain = opt.plan(sms, q0, target, duration=4.0, dt=0.02)
    turned = opt.plan(sms, q1, turn.act(target), duration=4.0, dt=0.02)
    np.testing.assert_allclose(turned.joint_positions, plain.joint_positions, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"duration": 0.0}, "duration"),
        ({"duration": -1.0}, "duration"),
        ({"dt": 0.0}, "dt"),
        ({"dt": 13.0}, "duration"),
        ({"kappa": 0.0}, "kappa"),
        ({"kappa": float("nan")}, "kappa"),
        ({"target": [1.0, 0.0]}, "target"),
        ({"target": [1.0, 0.0, float("inf")]}, "target"),
        ({"q0": np.zeros(3)}, "q0"),
    ],
)
def test_wrong_arguments_are_named(
    sms: ffsms.SpaceManipulator, change: dict[str, object], match: str
) -> None:
    arguments: dict[str, Any] = {"q0": sms.configuration([0, 0, 0]), "target": [1.0, 0.1, 0.0]}
    with pytest.raises(InvalidValue, match=match):
        opt.plan(sms, **(arguments | change))


def test_a_start_outside_the_limits_names_the_joint(sms: ffsms.SpaceManipulator) -> None:
    with pytest.raises(InvalidValue, match=r"joint 'joint_1'.*1\.5"):
        opt.plan(sms, sms.configuration([1.5, 0.0, 0.0]), [1.0, 0.1, 0.0])


@pytest.mark.parametrize("method", ["paper", "resolved-rate", "least-disturbance", "minimum-effort"])
def test_reference_methods_reach_the_target_at_a_higher_cost(
    sms: ffsms.SpaceManipulator, method: str
) -> None:
    q0, target = sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), CASES["case-1"]
    reference = opt.plan(sms, q0, target, dt=0.02, method=method)
    assert reference.reached
    assert (np.abs(reference.joint_rates) <= sms.limits.velocity + 1e-12).all()
    assert (np.abs(reference.joint_accelerations) <= sms.limits.acceleration + 1e-9).all()
    assert reference.cost_integral > opt.plan(sms, q0, target, dt=0.02).cost_integral


@pytest.mark.parametrize("method", ["resolved-rate", "least-disturbance", "minimum-effort"])
def test_an_unconstrained_reference_equals_its_weighted_inverse(
    sms: ffsms.SpaceManipulator, method: str
) -> None:
    """rates = W^-1 J^T (J W^-1 J^T)^-1 v, the closed form of least rates^T W rates with J rates = v."""
    free = ffsms.SpaceManipulator(sms.model, "end_effector", sms.base_size, acceleration=1e4)
    free = free.with_limits(dataclasses.replace(free.limits, velocity=np.full(3, 1e2)))
    weights = opt.StepWeights(speed=1.0, effort=1e-5, change=0.0)
    limits = [opt.JointLimits(), opt.AlphaBox()]
    planner = Stepper(free, 0.01, 10.0, limits, weights=weights, reference=method)
    q, target = sms.configuration([0.4, 0.7, -0.5]), np.array([0.75, 0.5, 0.0])
    rates = planner.step(q, np.zeros(3), target, 8.0).joint_rates

    state = sms.at(q)
    J = state.J_star[:2]
    spin = state.C_bm[3:]
    W = {
        "resolved-rate": np.eye(3),
        "least-disturbance": spin.T @ spin + 1e-9 * np.eye(3),
        "minimum-effort": state.H_q,
    }[method]
    inverse = np.linalg.inv(W) @ J.T
    expected = inverse @ np.linalg.solve(J @ inverse, J @ rates)
    np.testing.assert_allclose(rates, expected, atol=2e-4 * float(np.abs(rates).max()))
    towards = target - state.end_effector_pose.translation
    assert state.coupling.assistance(rates, towards) > 0.9999


def test_an_unknown_method_is_named(sms: ffsms.SpaceManipulator) -> None:
    with pytest.raises(InvalidValue, match=r"method.*'magic'"):
        opt.plan(sms, sms.configuration([0, 0, 0]), [1.0, 0.1, 0.0], method="magic")


@pytest.mark.parametrize("method", opt.METHODS)
def test_an_arm_at_its_target_stays(sms: ffsms.SpaceManipulator, method: str) -> None:
    q0 = sms.configuration([0.4, 0.7, -0.5])
    here = sms.at(q0).end_effector_pose.translation
    plan = opt.plan(sms, q0, here, duration=2.0, dt=0.05, method=method)
    assert plan.reached
    assert np.array_equal(plan.q, np.tile(q0, (41, 1)))
    assert not plan.v.any()
    assert not plan.cos_theta.any()


def test_plans_keep_clear_of_the_base_size_of_the_robot() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    target = [0.45, 0.75, 0.0]
    assert opt.plan(sms, q0, target, duration=12.0, dt=0.05).clear
    larger = ffsms.load("planar_3r", base_size=(1.2, 1.2, 0.5))
    assert not opt.plan(larger, q0, target, duration=12.0, dt=0.05).clear
