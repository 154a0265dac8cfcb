"""Warm starts, failed steps, threads, and identical bits in every process."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from step_parts import TARGET, StepJoints, StepRows, make_stepper, plan_stepwise, random_state

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError
from ffsms_pin.opt.evaluation import Rows
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.threads import InUse


@pytest.mark.parametrize("case", ["joint limit", "into the base", "panda"])
def test_warm_started_steps_agree_with_cold_starts(case: str) -> None:
    """Warm starts need fewer iterations."""
    sms = ffsms.load("satellite_panda" if case == "panda" else "planar_3r")
    if case == "panda":
        middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * sms.limits.upper
        q = sms.configuration(middle)
        goal = middle + 0.5 * half * np.random.default_rng(0).uniform(-1.0, 1.0, sms.n)
        target, duration = sms.at(sms.configuration(goal)).end_effector_pose.translation.copy(), 3.0
    elif case == "joint limit":
        q = sms.configuration(np.deg2rad([60.0, 30.0, -10.0]))
        beyond_limit = sms.configuration(np.deg2rad([105.0, 30.0, -10.0]))
        target, duration = sms.at(beyond_limit).end_effector_pose.translation, 4.0
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
def test_infeasible_steps_brake_within_the_limits_and_are_reported(name: str) -> None:
    """The rows of the limit contradict each other."""
    sms = ffsms.load(name)
    middle = 0.5 * (sms.limits.upper + sms.limits.lower)
    q, rates = sms.configuration(middle), 0.05 * sms.limits.velocity * np.linspace(-1.0, 1.0, sms.n)

    def contradiction(step: StepState) -> Rows:
        return Rows(np.vstack([step.J_star[:1]] * 2), np.array([0.9, -1.0]), np.array([1.0, -0.9]))

    stepper = Stepper(sms, 0.01, 10.0, [StepJoints(), StepRows(contradiction)])
    result = plan_stepwise(stepper, q, TARGET, 0.05)
    assert result.note == "the arm braked in 5 of 5 steps that were not solved"
    for _ in range(12):
        step = stepper.step(q, rates, TARGET, 5.0)
        assert not step.solved
        change = np.abs(step.joint_rates - rates)
        assert (change <= 0.01 * sms.limits.acceleration + 1e-15).all()
        if rates.any():
            # The rates keep their proportion, and one joint brakes at its limit.
            np.testing.assert_allclose(
                step.joint_rates * np.abs(rates).max(), rates * np.abs(step.joint_rates).max()
            )
            assert (change / (0.01 * sms.limits.acceleration)).max() == pytest.approx(
                1.0
            ) or not step.joint_rates.any()
        assert np.isfinite(step.cost)
        rates = step.joint_rates
    assert not rates.any()
    # The next feasible step is solved.
    stepper.limits = stepper.limits[:1]
    assert stepper.step(q, rates, TARGET, 5.0).solved


def test_a_stepper_in_two_threads_is_refused(planar: ffsms.SpaceManipulator) -> None:
    entered, leave = threading.Event(), threading.Event()

    def wait_in_limit(step: StepState) -> None:
        entered.set()
        assert leave.wait(10.0)

    stepper = Stepper(planar, 0.01, 10.0, [StepJoints(), StepRows(wait_in_limit)])
    q, rates = random_state(planar, 1)
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(stepper.step(q, rates, TARGET, 5.0)))
    thread.start()
    assert entered.wait(10.0)
    for call in (stepper.step, stepper.build):
        with pytest.raises(InUse, match=r"stepper.like\(\)") as caught:
            call(q, rates, TARGET, 5.0)
        assert isinstance(caught.value, FfsmsError)
    leave.set()
    thread.join()
    assert results[0].solved
    # The refusal has no effect on the running step, and the stepper works afterwards.
    expected = Stepper(planar, 0.01, 10.0, [StepJoints()]).step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(results[0].joint_rates, expected.joint_rates)
    assert stepper.step(q, rates, TARGET, 5.0).solved
    assert stepper.like()._alone is not stepper._alone


_BITS = """
import hashlib
import numpy as np
from step_parts import make_stepper, plan_stepwise
import ffsms_pin as ffsms
padding = [np.empty(size) for size in range(1, {padding})]  # other memory addresses
digest = hashlib.sha256()
for name, displacement in (("planar_3r", [-0.3, 0.3, 0.0]), ("satellite_panda", [-0.2, 0.3, 0.1])):
    sms = ffsms.load(name)
    q = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper) + 0.1)
    target = sms.at(q).end_effector_pose.translation + np.array(displacement)
    digest.update(plan_stepwise(make_stepper(sms), q, target, 3.0).rates.tobytes())
print(digest.hexdigest())
"""


def test_processes_give_the_same_bits() -> None:
    tests = Path(__file__).parents[2]
    code = f"import sys; sys.path[:0] = [{str(tests)!r}, {str(tests.parent)!r}]\n" + _BITS
    digests = {
        subprocess.run(
            [sys.executable, "-c", code.format(padding=padding)], capture_output=True, text=True, check=True
        ).stdout
        for padding in (2, 1777)
    }
    assert len(digests) == 1
