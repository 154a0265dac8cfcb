"""A client in a scenario file: its tables, and a short run to the end."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffsms_pin import scenarios
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.opt import Meet, Problem

SHORT = """
[robot]
model = "satellite_panda"
[start]
joints = [0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8]
[client]
mass = 80.0
inertia = [6.0, 9.0, 11.0]
joints = [0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9]
spin_deg = [1.0, 2.0, -1.0]
size = [0.5, 0.6, 0.7]
[meet]
grasp = [0.0, 0.0, -0.4]
standoff = 0.05
[plan]
duration = 6.0
dt = 0.02
[control]
law = "computed-torque"
K_p = 100.0
K_d = 20.0
dt = 0.004
[contact]
after = 4.0
"""


def _written(folder: Path, text: str) -> scenarios.Scenario:
    path = folder / "short.toml"
    path.write_text(text, encoding="utf-8")
    return scenarios.scenario(path)


def _problem(folder: Path, text: str) -> Problem:
    made = _written(folder, text)
    return made.problem(made.load())


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return scenarios.run(_written(tmp_path_factory.mktemp("short"), SHORT))


def test_the_client_is_caught_and_the_rate_is_as_said(outcome: Any) -> None:
    numbers = scenarios.summary(outcome)["capture"]
    assert outcome.trajectory.reached
    assert numbers["contact_velocity_m_per_s"] < 5e-3
    assert numbers["momentum_change_relative"] < 1e-12
    assert numbers["final_joint_rate_max_deg_per_s"] < 1e-3
    assert numbers["base_rate_error_deg_per_s"] < 5e-3
    assert np.linalg.norm(numbers["final_base_rate_deg_per_s"]) > 0.1
    # The recording's own momentum, of both, stays what it was at the capture.
    drift = np.abs(outcome.capture.tracking.momentum - outcome.capture.after.momentum).max()
    assert drift < 1e-8


def test_the_scene_holds_the_client(outcome: Any) -> None:
    viewer = pytest.importorskip("ffsms_pin.viewer")
    from ffsms_pin.scenarios.capture import whole_tracking
    from ffsms_pin.viewer.captured import CapturedClient

    whole = whole_tracking(outcome.tracking, outcome.capture)
    assert len(whole.t) == len(outcome.tracking.t) + len(outcome.capture.tracking.t) - 1
    client = CapturedClient(outcome.plant, whole, outcome.capture, 6.0)
    # It goes on from where it was, and then with the end effector.
    step = client.pose(6.0).translation - client.pose(5.996).translation
    assert np.linalg.norm(step) < 1e-3
    scene = viewer.view_capture(outcome, fps=2.0)
    assert "obstacles/0" in scene._stage.nodes or "obstacles/0" in str(scene._stage.scene.paths)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("[meet]\ngrasp = [0.0, 0.0, -0.4]\nstandoff = 0.05\n", "", r"\[meet\]"),
        ("[plan]", "[target]\nposition = [1.0, 0.0, 0.0]\n[plan]", "both say where"),
        ("size = [0.5", "position = [1.0, 0.0, 0.0]\nsize = [0.5", "both place it"),
        ("[contact]", "[contact]\nstiffness = 100.0", "compliant"),
        ("size = [0.5, 0.6, 0.7]", "size = [0.5, 0.6, 0.7]\n[client.sensor]\nperiod = 0.1", "re-planning"),
        ("inertia = [6.0, 9.0, 11.0]", "inertia = [1.0, 1.0, 11.0]", r"\[client\]"),
    ],
)
def test_what_does_not_fit_is_said(tmp_path: Path, old: str, new: str, word: str) -> None:
    assert old in SHORT
    with pytest.raises(InvalidScenario, match=word):
        _problem(tmp_path, SHORT.replace(old, new))


def test_the_packaged_scenario_meets_an_estimate() -> None:
    chosen = scenarios.scenario("capture")
    assert chosen.replans
    sms = chosen.load()
    problem = chosen.problem(sms)
    assert isinstance(problem.goal, Meet)
    assert problem.momentum is None
    place = problem.goal.place(chosen.arrival)
    joints = chosen.per_joint(sms, "client", "joints")
    # By construction: a posture of the arm is there at the deadline.
    assert joints is not None
    assert np.linalg.norm(place.position) < 2.0
