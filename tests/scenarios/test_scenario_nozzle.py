"""The packaged scenario "nozzle": a probe enters a throat, guided by contact."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from ffsms_pin import scenarios
from ffsms_pin.capture.visual_replanning import VisualReplanning
from ffsms_pin.client.client import other_motion
from ffsms_pin.scenarios.definition import packaged_path
from ffsms_pin.scenarios.problems import replanning

TEXT = packaged_path("nozzle").read_text("utf-8")


def _plain(tmp_path: Path, text: str) -> Path:
    """Return the scenario with a known client, a plan made once, a wider corridor and a compliant arm."""
    text = text.replace("half_angle_deg = 3.0", "half_angle_deg = 6.0")
    start = "[0.0, -20.0, -20.0, 90.0, 20.0, -60.0, -60.0]"
    packaged = "[30.0, -35.0, -40.0, 115.0, 25.0, -60.0, -80.0]"
    assert packaged in text
    text = text.replace(packaged, start)
    text = text.replace("K_p = 49.0", "K_p = 2.0").replace("K_d = 14.0", "K_d = 2.8")
    text = re.sub(
        r"^(reach = 0.1|misalignment_deg = 20.0|coulomb = 0.8|viscous = 4.0) .*\n", "", text, flags=re.M
    )
    for name in ("client.sensor", "client.belief", "reference"):
        text = re.sub(rf"^\[{re.escape(name)}\]\n(?:[^\[\n].*\n|\n)*", "", text, flags=re.M)
    path = tmp_path / "plain.toml"
    path.write_text(
        text.replace("after = 10.0", "after = 1.5").replace("dt = 0.005 ", "dt = 0.01 "),
        encoding="utf-8",
    )
    return path


@pytest.mark.slow
@pytest.mark.long
def test_a_plant_that_is_off_by_a_tenth_is_guided_into_the_throat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = scenarios.run(scenarios.scenario(_plain(tmp_path, TEXT)))
    record, numbers = outcome.capture, scenarios.summary(outcome)["capture"]
    assert record is not None
    assert numbers["caught"], numbers["missed"]
    forces = np.linalg.norm(record.whole.contact_wrench[:, :3], axis=1)
    guided = record.whole.t[: len(forces)] < record.contact_at - 1e-6
    assert 0.1 < forces[guided].max() < 20.0
    assert np.abs(record.whole.tau).max() < 150.0
    # The rod has a play of 1.4 mm in the throat, and bends.
    (closing,) = record.closings
    assert closing.miss[0] < 0.04
    assert record.momentum_error < 1e-6
    assert len(record.client.shapes) == 1 + 9  # its body, eight sides and a floor
    # MuJoCo simulates the flight with its own contact.
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    assert importlib.import_module("nozzle_in_mujoco").rates_off(outcome) < 0.01


def _error_after_a_push(use_momentum: bool) -> float:
    """Return the error of the expected grasp after the tip pushed the client with 20 N for a second [m]."""
    scenario = scenarios.scenario(packaged_path("nozzle"))
    sms = scenario.load()
    visual, q = replanning(scenario, sms), scenario.start_configuration(sms)
    assert isinstance(visual, VisualReplanning)
    client, momentum, grasp = scenario.made_client(sms), np.zeros(6), visual.problem.goal.grasp
    tip = sms.at(q).end_effector_pose.translation
    visual.pushed = use_momentum
    for t in 0.1 * np.arange(331):
        pose, twist = client.pose(0.1), client.twist(0.1)
        if 31.95 < t < 32.95:
            push, R = np.array([0.0, 2.0, 0.0]), pose.rotation  # [N s]
            rate_change = R @ np.linalg.solve(client.inertia, R.T @ np.cross(tip - pose.translation, push))
            twist = twist + np.append(push / client.mass, rate_change)
            momentum = momentum - np.append(push, np.cross(tip - sms.at(q).com, push))
        client = other_motion(client, pose, twist)
        visual.sees(t, pose, twist)
        visual.look(t, q, sms.velocity(q, np.zeros(7), momentum))
    expected = visual.problem.goal.client.pose(t + 5.0) * grasp
    return float(np.linalg.norm((client.pose(5.0) * grasp).translation - expected.translation))


@pytest.mark.slow
def test_a_push_is_estimated_from_the_robots_own_momentum() -> None:
    """The camera measures 0.2 s late, and its filter assumes a free client."""
    with_momentum, camera_alone = (
        _error_after_a_push(use_momentum=True),
        _error_after_a_push(use_momentum=False),
    )
    assert with_momentum < 0.25 * camera_alone, (with_momentum, camera_alone)
