"""Re-planning in a scenario file, limits on the base, and momentum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from condition_files import QUICK, run_text

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation as sim
from ffsms_pin.scenarios import summary


def test_re_planning_has_its_own_step_and_is_reported_beside_the_plan_made_once(
    tmp_path: Path, planar: ffsms.SpaceManipulator
) -> None:
    outcome = run_text(
        tmp_path,
        QUICK.replace("duration = 2.0", "duration = 4.0\nkappa = 5.0")
        + '[reference]\nkind = "re-planning"\ndt = 0.02\nhold = 0.5\n[plant]\narm_mass = 1.3\n',
    )
    tracked = opt.StepPlanner(planar, dt=0.02, kappa=5.0).track([0.75, 0.5, 0.0], 4.0, 0.5)
    reference = opt.Replanning(tracked.problem, 0.5, outcome.trajectory)  # it starts from the scenario's plan
    plant, law = sim.perturb(planar, arm_mass=1.3), control.ComputedTorque(planar)
    q0 = outcome.trajectory.q[0]
    again = sim.simulate(planar, reference, law, dt=0.01, q0=q0, plant=plant)
    np.testing.assert_array_equal(outcome.tracking.q, again.q)
    assert outcome.tracking.t[-1] == pytest.approx(4.5)
    assert outcome.open_loop is not None
    once = sim.simulate(planar, outcome.trajectory, law, dt=0.01, plant=plant)
    rows = len(once.t)
    np.testing.assert_allclose(outcome.open_loop.tracking.q[:rows], once.q, rtol=0.0, atol=1e-14)
    assert outcome.open_loop.tracking.t[-1] == pytest.approx(4.5)  # with the hold at the end of the plan
    numbers = summary(outcome)["tracking"]
    assert numbers["final_error_m"] == again.position_error[-1]
    assert numbers["open_loop"]["final_error_m"] == outcome.open_loop.tracking.position_error[-1]
    assert numbers["open_loop"]["final_error_m"] > 3.0 * numbers["final_error_m"]


def test_a_stopped_open_loop_is_reported_and_does_not_stop_re_planning(tmp_path: Path) -> None:
    """After a joint locks, re-planning continues with the other joints, and the plan made once is stopped."""
    outcome = run_text(
        tmp_path,
        QUICK.replace("duration = 2.0", "duration = 6.0")
        + '[reference]\nkind = "re-planning"\n[guards]\njoint_error = 0.05\n'
        + "[[fault]]\ntime = 1.0\njoint = 1\n",
    )
    assert outcome.open_loop is not None
    assert "joint_2' is 0.05" in outcome.open_loop.stopped
    report = summary(outcome)["tracking"]["open_loop"]
    assert report["arrived"] is False
    assert report["stopped"] == outcome.open_loop.stopped
    assert outcome.tracking.t[-1] == pytest.approx(6.0)
    assert "joint 'joint_2' has failed" in outcome.note


def test_momentum_of_the_plan_is_the_plants_unless_it_has_its_own(tmp_path: Path) -> None:
    momentum = [0.01, 0.0, 0.0, 0.0, 0.0, 0.002]
    content = QUICK.replace("[control]", f"momentum = {momentum}\n[control]")
    outcome = run_text(tmp_path, content)
    np.testing.assert_allclose(outcome.trajectory.momentum, momentum)
    np.testing.assert_allclose(outcome.tracking.momentum[-1], momentum, rtol=0.0, atol=1e-10)
    assert summary(outcome)["tracking"]["end_effector_deviation_max_m"] < 1e-4
    still = run_text(tmp_path, content + "[simulation]\nmomentum = [0, 0, 0, 0, 0, 0]\n")
    assert np.abs(still.tracking.momentum).max() < 1e-10
    assert summary(still)["tracking"]["end_effector_deviation_max_m"] > 1e-3


def test_re_planning_uses_base_limits_and_momentum(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    momentum = [0.0, 0.0, 0.0, 0.0, 0.0, 0.004]
    outcome = run_text(
        tmp_path,
        QUICK.replace("duration = 2.0", "duration = 4.0").replace(
            "[control]", f"momentum = {momentum}\n[plan.base_limits]\nattitude_rate_deg = 1.0\n[control]"
        )
        + '[reference]\nkind = "re-planning"\n',
    )
    limits = opt.BaseLimits(attitude_rate=float(np.radians(1.0)))
    planner = opt.StepPlanner(planar, dt=0.05, base_limits=limits, momentum=momentum)
    by_hand = sim.simulate(
        planar,
        opt.Replanning(planner.track([0.75, 0.5, 0.0], 4.0).problem, plan=outcome.trajectory),
        control.ComputedTorque(planar),
        dt=0.01,
        q0=outcome.trajectory.q[0],
        conditions=sim.Conditions(momentum=momentum),
    )
    np.testing.assert_array_equal(outcome.tracking.q, by_hand.q)


@pytest.mark.slow
def test_base_limits_are_kept(tmp_path: Path) -> None:
    content = QUICK.replace('method = "resolved-rate"', 'method = "horizon"')
    free = summary(run_text(tmp_path, content))["base"]
    limit = 0.5 * free["rotation_max_deg"]
    tight = run_text(tmp_path, f"{content}[plan.base_limits]\nattitude_deg = {limit}\ntranslation = inf\n")
    assert summary(tight)["base"]["rotation_max_deg"] <= limit * (1.0 + 1e-6)
