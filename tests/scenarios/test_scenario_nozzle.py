"""The packaged scenario "nozzle": a probe goes into a throat, guided by what it touches."""

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
    """The scenario with a client that is known, a plan made once, a wider way in, an arm that gives way."""
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
def test_a_plant_that_is_off_by_a_tenth_is_guided_into_the_throat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = scenarios.run(scenarios.scenario(_plain(tmp_path, TEXT)))
    found, numbers = outcome.capture, scenarios.summary(outcome)["capture"]
    assert found is not None
    assert numbers["caught"], numbers["missed"]
    forces = np.linalg.norm(found.whole.contact_wrench[:, :3], axis=1)
    guided = found.whole.t[: len(forces)] < found.contact_at - 1e-6
    assert 0.1 < forces[guided].max() < 20.0
    assert np.abs(found.whole.tau).max() < 150.0
    # In the throat: the rod has a play of 1.4 mm across it, and bends.
    (closing,) = found.closings
    assert closing.miss[0] < 0.04
    assert found.momentum_error < 1e-6
    assert len(found.client.shapes) == 1 + 9  # its body, eight sides and a floor
    # Flown again by MuJoCo, with its own contact.
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    assert importlib.import_module("nozzle_in_mujoco").rates_off(outcome) < 0.01


def _off_after_a_push(felt: bool) -> float:
    """The tip pushes the client with 20 N for a second: how far off is its grasp expected [m]?"""
    scenario = scenarios.scenario(packaged_path("nozzle"))
    sms = scenario.load()
    watching, q = replanning(scenario, sms), scenario.start_configuration(sms)
    assert isinstance(watching, VisualReplanning)
    client, ours, grasp = scenario.made_client(sms), np.zeros(6), watching.problem.goal.grasp
    tip = sms.at(q).end_effector_pose.translation
    watching.pushed = felt
    for t in 0.1 * np.arange(331):
        pose, twist = client.pose(0.1), client.twist(0.1)
        if 31.95 < t < 32.95:
            push, R = np.array([0.0, 2.0, 0.0]), pose.rotation  # [N s]
            turned = R @ np.linalg.solve(client.inertia, R.T @ np.cross(tip - pose.translation, push))
            twist = twist + np.append(push / client.mass, turned)
            ours = ours - np.append(push, np.cross(tip - sms.at(q).com, push))
        client = other_motion(client, pose, twist)
        watching.sees(t, pose, twist)
        watching.look(t, q, sms.velocity(q, np.zeros(7), ours))
    expected = watching.problem.goal.client.pose(t + 5.0) * grasp
    return float(np.linalg.norm((client.pose(5.0) * grasp).translation - expected.translation))


@pytest.mark.slow
def test_a_push_is_felt_by_the_robots_own_momentum() -> None:
    """The camera sees it 0.2 s later, and its filter believes in a free client."""
    felt, seen = _off_after_a_push(felt=True), _off_after_a_push(felt=False)
    assert felt < 0.25 * seen, (felt, seen)
