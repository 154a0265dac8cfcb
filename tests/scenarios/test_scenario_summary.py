"""The numbers of the summary compared with independent calculations."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scenario_files import QUICK, write

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.analysis import end_effector_deviation, position_range
from ffsms_pin.opt.flown import least_clearance
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.scenarios import Outcome, run, scenario, summary


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run(scenario(write(tmp_path_factory.mktemp("quick"), QUICK)))


@pytest.fixture(scope="module")
def numbers(outcome: Outcome) -> dict[str, Any]:
    return summary(outcome)


def test_a_summary_is_json_with_a_unit_in_every_quantity(numbers: dict[str, Any]) -> None:
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    units = r"_(m|s|ms|deg|rad|Nm|N|J|N2m2s|N2m2|relative)(_per_s2?)?$|_kg_m2?_per_s$"

    def leaves(value: Any, key: str) -> Iterator[tuple[str, Any]]:
        if isinstance(value, dict):
            for name, item in value.items():
                yield from leaves(item, name)
        elif isinstance(value, list):
            for item in value:
                yield from leaves(item, key)
        else:
            yield key, value

    for key, value in leaves({k: v for k, v in numbers.items() if k != "versions"}, ""):
        if isinstance(value, float) and key != "kappa":
            assert re.search(units, key), key


def test_numbers_of_the_plan_agree_with_its_states(outcome: Outcome, numbers: dict[str, Any]) -> None:
    plan, sms = outcome.trajectory, outcome.sms
    errors = [
        float(np.linalg.norm(sms.at(q).end_effector_pose.translation - np.array([0.75, 0.5, 0.0])))
        for q in plan.q
    ]
    assert numbers["reached"] is True
    assert numbers["final_error_m"] == pytest.approx(errors[-1], abs=1e-13)
    assert numbers["error_over_last_10_percent_m"] == pytest.approx(max(errors[54:]), abs=1e-13)
    assert numbers["cost_integral_s"] == pytest.approx(np.sum(plan.cost) * 0.05)
    assert numbers["joint_limits_kept"] is True
    for i, joint in enumerate(numbers["joints"]):
        rates, acceleration = plan.v[:, 6 + i], np.diff(plan.v[:, 6 + i]) / 0.05
        assert joint["rate_max_deg_per_s"] == pytest.approx(np.degrees(np.abs(rates).max()))
        assert joint["acceleration_max_deg_per_s2"] == pytest.approx(np.degrees(np.abs(acceleration).max()))
        assert joint["rate_limit_deg_per_s"] == pytest.approx(22.92, abs=5e-3)
        assert joint["acceleration_limit_deg_per_s2"] == pytest.approx(28.65, abs=5e-3)
        assert joint["tracking_torque_max_Nm"] == np.abs(outcome.tracking.tau[:, i]).max()
    assert [joint["torque_limit_Nm"] for joint in numbers["joints"]] == [3.5, 1.5, 1.5]
    assert numbers["joints"][0]["position_upper_limit_deg"] == pytest.approx(81.0)


def test_positions_between_nodes_count(outcome: Outcome, numbers: dict[str, Any]) -> None:
    dense = np.array([outcome.trajectory.sample(t)[0] for t in np.linspace(0.0, 3.0, 60_001)])
    for i, joint in enumerate(numbers["joints"]):
        assert joint["position_min_deg"] == pytest.approx(np.degrees(dense[:, i].min()), abs=1e-6)
        assert joint["position_max_deg"] == pytest.approx(np.degrees(dense[:, i].max()), abs=1e-6)
        assert np.radians(joint["position_max_deg"]) >= dense[:, i].max() - 1e-12


def test_a_turn_inside_a_step_is_an_extreme(planar: ffsms.SpaceManipulator) -> None:
    """Rates +0.3 and -0.1 at a step's ends: the joint turns at 3/4 of it, higher than at either node."""
    rates = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, -0.2], [-0.1, 0.1, 0.0]])
    problem = opt.Problem(planar, planar.configuration([0.1, 0.2, 0.3]), [1.0, 0.0, 0.0], 2.0, 1.0)
    low, high = position_range(measure(problem, rates))
    np.testing.assert_allclose(high, [0.1 + 0.15 + 0.1125, 0.2 + 0.05 + 0.1, 0.3])
    np.testing.assert_allclose(low, [0.1, 0.2, 0.3 - 0.1 - 0.1])


def test_a_clearance_between_nodes_counts(planar: ffsms.SpaceManipulator) -> None:
    """Joint 2 folds to 2.2 rad half-way through the second step, which moves joint 3 towards the base."""
    rates = np.array([[0.0, 0.0, 0.0], [0.0, 2.4, 0.0], [0.0, -2.4, 0.0]])
    problem = opt.Problem(planar, planar.configuration([0.0, 0.4, 0.3]), [1.0, 0.0, 0.0], 2.0, 1.0)
    least = least_clearance(problem, planar, problem.motion(rates))
    assert least is not None
    assert (least.pair, least.time) == ("joint_3 - base box", 1.5)
    assert least.distance == pytest.approx(0.3 * (1.0 + np.cos(2.2)), abs=1e-12)  # from the face of the box


def test_a_plan_beyond_a_limit_is_reported(outcome: Outcome) -> None:
    limits = replace(outcome.sms.limits, velocity=0.5 * np.abs(outcome.trajectory.joint_rates).max(axis=0))
    tighter = ffsms.load("planar_3r").with_limits(limits)
    report = summary(replace(outcome, sms=tighter))
    assert report["joint_limits_kept"] is False
    assert [joint["limits_kept"] for joint in report["joints"]] == [False] * 3


def test_clearances_of_the_plan_agree_with_planar_geometry(outcome: Outcome, numbers: dict[str, Any]) -> None:
    """Use the planar geometry: links of 0.3 m from (0.232, 0) in base axes, and a box of 0.464 m."""
    times = np.linspace(0.0, 3.0, 30_001)
    angles = np.cumsum([outcome.trajectory.sample(t)[0] for t in times], axis=1)
    links = 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.concatenate([np.zeros((len(times), 1, 2)), np.cumsum(links, axis=1)], axis=1)
    points[..., 0] += 0.232
    pairs = {
        "joint_1 - joint_3": _least_distance(points, 0, 2),
        "joint_1 - end_effector": _least_distance(points, 0, 3),
        "joint_2 - end_effector": _least_distance(points, 1, 3),
    }
    for i, name in ((1, "joint_2"), (2, "joint_3"), (3, "end_effector")):
        pairs[f"{name} - base box"] = float((np.abs(points[:, i]).max(axis=-1) - 0.232).min())
    report = numbers["clearance"]
    pair = min(pairs, key=lambda name: pairs[name])
    assert report["pair"] == pair
    assert report["least_m"] == pytest.approx(pairs[pair], abs=2e-5)
    assert report["required_m"] == 0.01


def test_the_clearance_of_the_simulated_motion_agrees_with_planar_geometry(
    outcome: Outcome, numbers: dict[str, Any]
) -> None:
    """Use the same geometry at the recorded joint positions."""
    angles = np.cumsum(outcome.tracking.q[:, 7:], axis=1)
    links = 0.3 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.concatenate([np.zeros((len(angles), 1, 2)), np.cumsum(links, axis=1)], axis=1)
    points[..., 0] += 0.232
    least = min(_least_distance(points, 0, 2), _least_distance(points, 0, 3), _least_distance(points, 1, 3))
    least = min(least, float((np.abs(points[:, 1:]).max(axis=-1) - 0.232).min()))
    assert numbers["tracking"]["clearance"]["least_m"] == pytest.approx(least, abs=1e-4)
    assert numbers["tracking"]["clearance"]["least_m"] >= least - 1e-12


def _least_distance(points: NDArray[np.float64], i: int, j: int) -> float:
    return float(np.linalg.norm(points[:, i] - points[:, j], axis=-1).min())


def test_base_motion_agrees_with_the_yaw(outcome: Outcome, numbers: dict[str, Any]) -> None:
    for base, q in (
        (numbers["base"], outcome.trajectory.q),
        (numbers["tracking"]["base"], outcome.tracking.q),
    ):
        yaw = np.degrees(2.0 * np.arctan2(q[:, 5], q[:, 6]))
        moved = np.hypot(*(q[:, :2] - q[0, :2]).T)
        assert base["rotation_max_deg"] == pytest.approx(np.abs(yaw).max(), abs=1e-9)
        assert base["rotation_final_deg"] == pytest.approx(abs(yaw[-1]), abs=1e-9)
        assert base["translation_max_m"] == pytest.approx(moved.max(), abs=1e-14)
        assert base["translation_final_m"] == pytest.approx(moved[-1], abs=1e-14)


def test_numbers_of_the_tracking_agree_with_its_states(outcome: Outcome, numbers: dict[str, Any]) -> None:
    tracking, sms, report = outcome.tracking, outcome.sms, numbers["tracking"]
    assert report["control_step_s"] == pytest.approx(0.004)
    desired = np.array([outcome.trajectory.sample(t)[0] for t in tracking.t])
    error = np.abs(tracking.q[:, 7:] - desired)
    assert report["joint_error_max_rad"] == pytest.approx(error.max(), abs=1e-14)
    assert report["joint_error_final_rad"] == pytest.approx(error[-1].max(), abs=1e-14)
    end = sms.at(tracking.q[-1]).end_effector_pose.translation
    assert report["final_error_m"] == pytest.approx(np.linalg.norm(end - [0.75, 0.5, 0.0]), abs=1e-14)
    planned_end = sms.at(outcome.trajectory.q[-1]).end_effector_pose.translation
    assert report["end_effector_deviation_final_m"] == pytest.approx(
        np.linalg.norm(end - planned_end), abs=1e-14
    )
    momentum = np.array(
        [sms.at(q, v).momentum for q, v in zip(tracking.q[::25], tracking.v[::25], strict=True)]
    )
    assert report["momentum_linear_max_kg_m_per_s"] >= np.linalg.norm(momentum[:, :3], axis=1).max() - 1e-14
    assert report["momentum_linear_max_kg_m_per_s"] < 1e-12
    assert report["momentum_angular_max_kg_m2_per_s"] < 1e-12
    power = np.einsum("ij,ij->i", tracking.tau, np.diff(tracking.q[:, 7:], axis=0))  # work of held torques
    energy = sms.at(tracking.q[-1], tracking.v[-1]).kinetic_energy
    energy -= sms.at(tracking.q[0], tracking.v[0]).kinetic_energy
    assert energy == pytest.approx(power.sum(), rel=1e-6, abs=1e-9 * report["kinetic_energy_max_J"])
    assert report["energy_error_relative"] < 1e-6


def test_deviations_between_the_steps_of_the_plan(outcome: Outcome, numbers: dict[str, Any]) -> None:
    """Steps of 50 and 4 ms meet every 200 ms; in between the plan is carried on to the control instant."""
    deviation = end_effector_deviation(outcome.sms, outcome.trajectory, outcome.tracking)
    assert len(deviation) == len(outcome.trajectory.t)
    row = int(np.searchsorted(outcome.tracking.t, 0.55 - 1e-9))
    t = float(outcome.tracking.t[row])
    assert t == pytest.approx(0.552)
    # The planned base between nodes, by a smooth curve through its node poses.
    planned = []
    for k in range(9, 14):
        pose = pin.XYZQUATToSE3(outcome.trajectory.q[k, :7])
        yaw = 2.0 * np.arctan2(outcome.trajectory.q[k, 5], outcome.trajectory.q[k, 6])
        planned.append([*pose.translation[:2], yaw])
    x, y, yaw = (
        np.polyval(np.polyfit(outcome.trajectory.t[9:14] - 0.55, column, 4), t - 0.55)
        for column in np.array(planned).T
    )
    base = pin.SE3(pin.utils.rotate("z", float(yaw)), np.array([x, y, 0.0]))
    at_plan = outcome.sms.configuration(outcome.trajectory.sample(t)[0], base)
    places = [outcome.sms.at(q).end_effector_pose.translation for q in (at_plan, outcome.tracking.q[row])]
    assert deviation[11] == pytest.approx(np.linalg.norm(places[1] - places[0]), abs=1e-6)
    assert numbers["tracking"]["end_effector_deviation_max_m"] == deviation.max()


def test_timing_is_per_step(outcome: Outcome) -> None:
    report = summary(replace(outcome, timing=type(outcome.timing)(0.6, 1.5)))["timing"]
    assert report["planning_per_step_ms"] == pytest.approx(600.0 / 60)
    assert report["tracking_per_control_step_ms"] == pytest.approx(1500.0 / 750)
