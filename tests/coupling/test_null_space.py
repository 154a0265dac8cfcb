"""The reaction null space: its dimension, and the base at rest over a finite motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.robot.base_motion import advance

Array = NDArray[np.float64]
Kept = Literal["attitude", "twist"]
ROWS = {"attitude": slice(3, 6), "twist": slice(0, 6)}


@cache
def robot(name: str) -> ffsms.SpaceManipulator:
    return ffsms.load(name)


def posture(sms: ffsms.SpaceManipulator, rng: Any) -> Array:
    base = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-1, 1, size=3)), rng.uniform(-1, 1, size=3))
    return sms.configuration(rng.uniform(sms.limits.lower, sms.limits.upper), base)


@pytest.mark.parametrize(
    ("name", "attitude", "twist"),
    [
        ("planar_3r", 2, 0),  # the base can turn about one axis, and translate along two
        ("space_arm_7", 4, 1),
        ("satellite_panda", 4, 1),
        ("satellite_ur5", 3, 0),
    ],
)
def test_dimension_and_completeness(name: str, attitude: int, twist: int, rng: Any) -> None:
    sms = robot(name)
    for _ in range(20):
        state = sms.at(posture(sms, rng))
        for of, dimension in (("attitude", attitude), ("twist", twist)):
            N = state.reaction_null_space(of)  # type: ignore[arg-type]
            assert N.shape == (sms.n, dimension)
            np.testing.assert_allclose(N.T @ N, np.eye(dimension), rtol=0.0, atol=1e-14)
            for column in N.T:
                state_with_motion = sms.at(state.q, sms.velocity(state.q, column))
                assert np.abs(state_with_motion.base_twist[ROWS[of]]).max() < 1e-9 * state.coupling.sigma[0]
            # The null space is complete: all orthogonal motions move the base.
            rest = np.linalg.svd(N.T)[2][dimension:].T if dimension else np.eye(sms.n)
            weakest = np.linalg.svd(state.C_bm[ROWS[of]] @ rest, compute_uv=False)[sms.n - dimension - 1]
            assert weakest > 1e-9 * state.coupling.sigma[0]
    assert state.reaction_null_space().shape == (sms.n, attitude)


@pytest.mark.parametrize("n", [1, 4, 9])
def test_dimension_of_random_trees(random_tree: Callable[..., Any], n: int) -> None:
    for seed in range(5):
        sms = ffsms.SpaceManipulator(random_tree(seed, n, ("revolute", "prismatic")).model(), "tip")
        state = sms.at(sms.configuration(np.random.default_rng(seed).uniform(-1, 1, size=n)))
        assert state.reaction_null_space("attitude").shape == (n, max(0, n - 3))
        assert state.reaction_null_space("twist").shape == (n, max(0, n - 6))


def integrate_rates(
    sms: ffsms.SpaceManipulator, q: Array, requested: Array, of: Kept | None, duration: float, steps: int
) -> Array:
    """Return the end (nq,) of a motion at requested joint rates, projected to the null space of `of`."""

    def rates_at(q: Array) -> Array:
        if of is None:
            return requested
        N = sms.at(q).reaction_null_space(of)
        return np.asarray(N @ (N.T @ requested))

    dt, rates = duration / steps, rates_at(q)
    for _ in range(steps):
        ahead, _ = advance(sms, q, rates, np.zeros(sms.n), dt)
        after = rates_at(ahead)
        q, rates = advance(sms, q, rates, (after - rates) / dt, dt)
    return q


def base_change(start: Array, end: Array, of: Kept) -> float:
    change = pin.log6(pin.XYZQUATToSE3(start[:7]).inverse() * pin.XYZQUATToSE3(end[:7])).vector
    return float(np.linalg.norm(change[ROWS[of]]))


@pytest.mark.parametrize(
    ("name", "of"),
    [
        ("planar_3r", "attitude"),
        ("space_arm_7", "attitude"),
        ("space_arm_7", "twist"),
        ("satellite_panda", "attitude"),
        ("satellite_panda", "twist"),
    ],
)
def test_the_base_stays_over_a_finite_motion(name: str, of: Kept) -> None:
    sms, rng = robot(name), np.random.default_rng(8)
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper) + rng.uniform(0.2, 0.5, size=sms.n))
    requested = rng.uniform(0.3, 0.6, size=sms.n) * rng.choice([-1.0, 1.0], size=sms.n)
    free = base_change(q0, integrate_rates(sms, q0, requested, None, 1.0, 50), of)
    errors = []
    for steps in (50, 100):
        end = integrate_rates(sms, q0, requested, of, 1.0, steps)
        errors.append(base_change(q0, end, of))
        assert np.linalg.norm(sms.joint_positions(end) - sms.joint_positions(q0)) > 0.1
    # Rates are linear between nodes, so they leave the null space by less with shorter steps.
    assert free > 5e-3
    assert errors[0] < 1e-3 * free
    assert errors[1] < 0.4 * errors[0]


def test_a_joint_that_cannot_turn_the_base_is_in_the_null_space() -> None:
    # The mass slides along a line through all centres of mass, so the base turns by rounding alone.
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    model.appendBodyToJoint(
        joint, pin.Inertia(50.0, np.zeros(3), np.diag([4.0, 5.0, 6.0])), pin.SE3.Identity()
    )
    axis = np.array([1.0, 2.0, 2.0]) / 3.0
    joint = model.addJoint(joint, pin.JointModelPrismaticUnaligned(*axis), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(3.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("mass", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    sms = ffsms.SpaceManipulator(model, "mass")
    rotation = pin.rpy.rpyToMatrix(np.array([0.3, -0.7, 1.1]))
    state = sms.at(sms.configuration([0.83], pin.SE3(rotation, np.ones(3))))
    np.testing.assert_allclose(np.abs(state.reaction_null_space("attitude")), [[1.0]], rtol=0.0, atol=1e-14)
    assert state.reaction_null_space("twist").shape == (1, 0)


def test_the_dimension_grows_with_the_tolerance(rng: Any) -> None:
    sms = robot("satellite_panda")
    state = sms.at(posture(sms, rng))
    sigma, before = state.coupling.sigma, 0
    for tolerance in (0.0, 1e-10, 1e-3, 1e-2, 0.1, 0.5, 0.999):
        N = state.reaction_null_space("twist", tolerance=tolerance)
        assert N.shape[1] == sms.n - np.count_nonzero(sigma > tolerance * sigma[0])
        assert N.shape[1] >= before
        before = N.shape[1]
        if before:
            assert np.linalg.norm(state.C_bm @ N, 2) <= tolerance * sigma[0] + 1e-15
    assert before == sms.n - 1


@pytest.mark.parametrize("of", ["translation", None])
def test_an_unknown_base_motion_is_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError], of: Any
) -> None:
    state = planar.at(planar.configuration([0.1, 0.2, 0.3]))
    refused(lambda: state.reaction_null_space(of), InvalidValue, "of must", '"attitude" or "twist"')


@pytest.mark.parametrize("tolerance", [-1e-3, 1.0, np.nan])
def test_a_wrong_tolerance_is_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError], tolerance: Any
) -> None:
    state = planar.at(planar.configuration([0.1, 0.2, 0.3]))
    refused(lambda: state.reaction_null_space("attitude", tolerance), InvalidValue, "tolerance must")
