"""Re-planning while thrusters dump the momentum of attitude-holding wheels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from base_actuators import PYRAMID, THRUSTER_DIRECTIONS, THRUSTER_POSITIONS

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import Coordinated, MomentumDump
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.rest import rest_of
from ffsms_pin.opt.rollouts import wheel_total
from ffsms_pin.simulation import Observer, Tracking

TARGET, DURATION, DT = [0.45, 0.75, 0.0], 8.0, 0.08
# The initial momentum leaves little capacity in the direction that the arm needs [N m s].
MOMENTUM_LIMIT, INITIAL_MOMENTUM = 0.06, np.full(4, -0.05)
RARE_REPLANS = ReplanOptions(period=0.4, search_again=100.0)  # for a short run time


class WithoutWheelMeasurement(Observer):
    """A reference without measurements of the wheels."""

    def __init__(self, reference: opt.Replanning) -> None:
        self.duration, self.target = reference.duration, reference.target
        self.sample, self._reference = reference.sample, reference

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Pass on the state alone."""
        self._reference.observe(t, q, v)


@pytest.fixture(scope="module")
def problem() -> opt.Problem:
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, 0.1, MOMENTUM_LIMIT)
    thrusters = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 0.5, proportional=True)
    sms = ffsms.load("planar_3r").with_actuators(wheels=wheels, thrusters=thrusters)
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.Problem(
        sms, q0, TARGET, DURATION, DT, mode="rotation-floating", wheel_momentum=INITIAL_MOMENTUM
    )


@pytest.fixture(scope="module")
def plan(problem: opt.Problem) -> opt.Trajectory:
    return opt.solve(problem)


def simulate_reference(problem: opt.Problem, reference: Any, dump: bool = True) -> Tracking:
    # The arm returns momentum to the wheels after a dump, which starts the next dump.
    momentum_dump = MomentumDump(above=0.15, below=0.05, time_constant=1.0)
    law = Coordinated(problem.sms, 100.0, 20.0, bandwidth=2.0, dump=momentum_dump if dump else None)
    values: dict[str, Any] = {"q0": problem.q0, "base_controller": law, "wheel_momentum": INITIAL_MOMENTUM}
    return ffsms.simulate(problem.sms, reference, law, 2e-2, **values)


def total(sms: ffsms.SpaceManipulator, run: Tracking, k: int) -> FloatArray:
    """Return the wheels' momenta with all other bodies at rest, from row k of a run."""
    assert sms.wheels is not None
    return wheel_total(sms, sms.wheels, run.q[k], run.v[k], run.wheel_momentum[k])


@pytest.mark.slow
@pytest.mark.long
def test_replanning_uses_the_measured_wheel_momentum_after_a_dump(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    """The plan would saturate the wheels; re-planning arrives if it has measurements of the wheels."""
    assert not plan.reached
    assert "the wheels would saturate" in plan.note
    informed = opt.Replanning(problem, 4.0, plan, options=RARE_REPLANS)
    run = simulate_reference(problem, informed)
    assert (run.position_error[run.t >= DURATION] < 1e-3).all()
    assert "no motion found" not in informed.note
    assert np.abs(run.wheel_momentum).max() < MOMENTUM_LIMIT
    assert np.abs(total(problem.sms, run, -1)).max() < 0.2 * np.abs(INITIAL_MOMENTUM).max()
    uninformed = opt.Replanning(problem, plan=plan, options=RARE_REPLANS)
    run = simulate_reference(problem, WithoutWheelMeasurement(uninformed))
    assert run.position_error[-1] > 0.1
    assert "no motion found that arrives" in uninformed.note


def test_without_a_dump_the_wheel_total_is_conserved(problem: opt.Problem, plan: opt.Trajectory) -> None:
    """The remaining problem takes the measured total, or by default the conserved total."""
    sms = problem.sms
    run = simulate_reference(problem, plan, dump=False)
    for k in (0, 75, 166, 400):
        np.testing.assert_allclose(total(sms, run, k), problem.wheel_total, atol=1e-9)
    k = 35
    joints, rates = plan.joint_positions[k], plan.joint_rates[k]
    state = (problem, sms, k * DT, plan.q[k], joints, rates, plan.q[0, :7])
    uninformed, informed = rest_of(*state), rest_of(*state, wheel_total=problem.wheel_total + 0.01)
    np.testing.assert_allclose(uninformed.wheel_momentum, plan.wheel_momentum[k], atol=1e-12)
    np.testing.assert_allclose(informed.wheel_momentum, plan.wheel_momentum[k] + 0.01, atol=1e-12)
    np.testing.assert_allclose(informed.wheel_total, problem.wheel_total + 0.01, atol=1e-12)


def test_wheel_momenta_are_checked(problem: opt.Problem, refused: Callable[..., FfsmsError]) -> None:
    reference = opt.Replanning(problem)
    refused(lambda: reference.observe_wheels(np.ones(3)), InvalidValue, "momentum", "(4,)")
    floating = opt.Replanning(opt.Problem(problem.sms, problem.q0, TARGET, DURATION, DT))
    floating.observe_wheels(np.ones(4))  # ignored in floating mode
