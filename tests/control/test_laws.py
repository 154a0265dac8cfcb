"""The joint laws: Lyapunov functions, time constants, and the Coriolis matrix of the reduced system."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import START, Swing, random_pose
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.control import (
    LAWS,
    PD,
    ComputedTorque,
    SlidingModeController,
)
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation import Conditions, JointFriction, Tracking, WristSensor, simulate

Array = NDArray[np.float64]
DISPLACEMENT = (0.9, 1.2, -0.9)


def values(law: SlidingModeController | ComputedTorque | PD, tracking: Tracking) -> Array:
    """Return V of the law's proof along a run (N + 1,)."""
    e, rate = tracking.joint_error, tracking.joint_rate_error
    if isinstance(law, SlidingModeController):
        e, rate = np.zeros_like(e), rate + e @ law.Gamma
    stiffness = np.zeros((3, 3)) if isinstance(law, SlidingModeController) else law.K_p
    mass = np.array([np.eye(3) if isinstance(law, ComputedTorque) else law.sms.at(q).H_q for q in tracking.q])
    V = np.einsum("ki,kij,kj->k", rate, mass, rate) + np.einsum("ki,ij,kj->k", e, stiffness, e)
    return np.asarray(0.5 * V)


@pytest.mark.parametrize(("seed", "n"), [(1, 1), (2, 3), (3, 7), (4, 9)])
def test_coriolis_matrix_of_the_reduced_system(
    seed: int, n: int, random_tree: Callable[..., Any], rng: np.random.Generator
) -> None:
    kinds = ("revolute", "prismatic", "continuous")
    sms = ffsms.SpaceManipulator(random_tree(seed, n, kinds).model(), "tip")
    for _ in range(4):
        q = sms.configuration(rng.uniform(-2.0, 2.0, n), random_pose(rng))
        qd = rng.normal(size=n)
        v = sms.velocity(q, qd)
        state = sms.at(q, v)
        C = state.C_q_matrix
        scale = float(np.abs(C).max()) + np.abs(state.H_q).max()
        np.testing.assert_allclose(C @ qd, state.C_q, atol=1e-12 * scale)
        # dH_q/dt by differences along the motion: order 4, so that it is right to 1e-10.
        h = 1e-3
        H_q = [sms.at(pin.integrate(sms.model, q, k * h * v)).H_q for k in (-2, -1, 1, 2)]
        rate = (H_q[0] - 8.0 * H_q[1] + 8.0 * H_q[2] - H_q[3]) / (12.0 * h)
        skew = rate - 2.0 * C
        assert np.abs(rate).max() > 1e-3 * scale or n == 1
        np.testing.assert_allclose(skew, -skew.T, atol=1e-9 * scale)
        # Momentum does not change it.
        moving = sms.velocity(q, qd, rng.normal(size=6))
        np.testing.assert_allclose(sms.at(q, moving).C_q_matrix, C, atol=1e-12 * scale)


def test_neglected_term_of_the_paper_shows(planar: ffsms.SpaceManipulator) -> None:
    # V of the paper rises in a fast motion with a small gain K_s; it never rises if K_s outweighs the term.
    reference = Swing(planar, (1.2, 2.0, -2.0), duration=1.5)
    q0 = planar.configuration(START + np.array([0.2, -0.1, 0.15]))
    rises = []
    for K_s in (1e-4, 0.3):
        law = SlidingModeController(planar, K_s=K_s, torque_limit=np.inf, boundary=0.2)
        V = values(law, simulate(planar, reference, law, q0=q0, conditions=Conditions(guards=None)))
        rises.append(np.diff(V).max() / V[0])
    assert rises[0] > 1e-5
    assert rises[1] < 1e-8


def test_computed_torque_error_is_linear_and_v_decreases(planar: ffsms.SpaceManipulator) -> None:
    reference = Swing(planar, DISPLACEMENT, 3.0)
    law = ComputedTorque(planar, K_p=9.0, K_d=6.0, torque_limit=np.inf)
    tracking = simulate(
        planar, reference, law, q0=planar.configuration(START + 0.2), conditions=Conditions(guards=None)
    )
    assert np.diff(values(law, tracking))[1:].max() < 1e-8
    # Critically damped at 3 rad/s; the torque, held over a step, is half a step late.
    expected = 0.2 * (1.0 + 3.0 * tracking.t) * np.exp(-3.0 * tracking.t)
    np.testing.assert_allclose(tracking.joint_error, np.tile(expected[:, None], 3), atol=2e-3)


def test_known_friction_is_compensated(planar: ffsms.SpaceManipulator) -> None:
    reference, friction, errors = Swing(planar, DISPLACEMENT, 3.0), {"coulomb": 0.02, "viscous": 0.05}, []
    for share in (0.0, 0.8, 1.0):
        believed = {name: share * size for name, size in friction.items()}
        law = ComputedTorque(planar, **believed, adaptive=False)
        run = simulate(
            planar,
            reference,
            law,
            2e-3,
            conditions=Conditions(friction=JointFriction(**friction), guards=None),
        )
        errors.append(np.abs(run.joint_error).max())
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.05 * errors[0]
    with pytest.raises(InvalidValue, match="coulomb"):
        ComputedTorque(planar, coulomb=-0.1)


def test_pd_brings_the_joints_to_rest_with_v_decreasing(planar: ffsms.SpaceManipulator) -> None:
    reference = Swing(planar, np.zeros(3), duration=8.0)
    law = PD(planar, torque_limit=np.inf)
    q0 = planar.configuration(START + np.array([0.4, -0.3, 0.2]))
    tracking = simulate(planar, reference, law, dt=2e-3, q0=q0, conditions=Conditions(guards=None))
    V = values(law, tracking)
    assert np.diff(V)[1:].max() < 1e-9 * V[0]  # from rest, where dV/dt = 0, a held torque may gain a trifle
    assert np.abs(tracking.joint_error[-1]).max() < 1e-2
    moving = Swing(planar, DISPLACEMENT, 8.0)
    largest_error = np.abs(
        simulate(planar, moving, law, dt=2e-3, conditions=Conditions(guards=None)).joint_error
    ).max()
    assert (
        largest_error
        > 10.0
        * np.abs(
            simulate(
                planar, moving, ComputedTorque(planar), dt=2e-3, conditions=Conditions(guards=None)
            ).joint_error
        ).max()
    )


@pytest.mark.parametrize("name", sorted(LAWS))
def test_every_law_follows_the_move(name: str, planar: ffsms.SpaceManipulator) -> None:
    law = LAWS[name](planar)
    tracking = simulate(
        planar, Swing(planar, (0.3, 0.4, -0.3), 3.0), law, 2e-3, conditions=Conditions(wrist=WristSensor())
    )
    limit = 0.2 if name == "pd" else 1e-3
    assert np.abs(tracking.joint_error).max() < limit
    assert np.abs(tracking.momentum).max() < 1e-12
    assert tracking.effort > 0.0
    assert tracking.chatter > 0.0


def test_effort_and_chatter_are_integrals(planar: ffsms.SpaceManipulator) -> None:
    tracking = simulate(
        planar,
        Swing(planar, DISPLACEMENT, 3.0),
        ComputedTorque(planar),
        dt=0.01,
        conditions=Conditions(guards=None),
    )
    assert tracking.effort == pytest.approx(float((tracking.tau**2).sum() * 0.01))
    steps = tracking.tau[1:] - tracking.tau[:-1]
    assert tracking.chatter == pytest.approx(float((steps**2).sum() / 0.01))


def test_time_constants_are_those_of_the_simulated_error(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration(START)
    law = PD(planar, K_p=[5.0, 4.0, 3.0], K_d=[6.0, 5.0, 4.0])
    constants = law.time_constants(q)
    # Independent route: the loop's linearisation by differences of forward dynamics.
    data = planar.model.createData()

    def acceleration(x: Array) -> Array:
        full = planar.configuration(START + x[:3])
        v = planar.velocity(full, x[3:])
        tau = law.torque(full, v, START, np.zeros(3), np.zeros(3))
        return np.array(pin.aba(planar.model, data, full, v, np.concatenate([np.zeros(6), tau]))[6:])

    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    for i, e in enumerate(1e-6 * np.eye(6)):
        A[3:, i] = (acceleration(e) - acceleration(-e)) / 2e-6
    np.testing.assert_allclose(constants, np.sort(-1.0 / np.linalg.eigvals(A).real), rtol=1e-5)
    np.testing.assert_allclose(ComputedTorque(planar, 8.0, 6.0).time_constants(q), [0.25] * 3 + [0.5] * 3)
