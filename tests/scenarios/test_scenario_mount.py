"""An arm mounted on a satellite by a scenario file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import write

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError
from ffsms_pin.scenarios import run, scenario

FILE = """
[robot]
model = "ur5"
velocity = 0.4
[robot.mount]
mass = 400.0
size = [1.5, 1.0, 1.2]
position = [0.75, 0.1, 0.0]
[start]
joints = [0.0, -1.2, 1.8, -0.6, 1.0, 0.0]
[target]
position = [0.0, 0.0, 0.05]
relative_to = "start"
[plan]
duration = 3.0
dt = 0.05
[control]
law = "computed-torque"
dt = 0.01
"""


def _mass(sms: ffsms.SpaceManipulator) -> float:
    return float(pin.computeTotalMass(sms.model))


def test_the_robot_equals_that_of_mount(tmp_path: Path) -> None:
    sms = scenario(write(tmp_path, FILE)).load()
    base = ffsms.SatelliteBase(mass=400.0, size=(1.5, 1.0, 1.2))
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    same = ffsms.mount("ur5", base, pin.SE3(turn, np.array([0.75, 0.1, 0.0])), velocity=0.4)
    assert sms.joint_names == same.joint_names
    assert _mass(sms) == _mass(same)
    q = same.configuration([0.0, -1.2, 1.8, -0.6, 1.0, 0.0])
    np.testing.assert_array_equal(sms.at(q).H_b, same.at(q).H_b)
    np.testing.assert_array_equal(sms.limits.velocity, same.limits.velocity)


def test_a_mounted_arm_is_planned_and_followed(tmp_path: Path) -> None:
    outcome = run(scenario(write(tmp_path, FILE)))
    assert outcome.trajectory.reached
    assert np.linalg.norm(outcome.tracking.position_error[-1]) < 1e-3


def test_an_empty_table_is_the_default_satellite(tmp_path: Path) -> None:
    text = FILE.replace("mass = 400.0\nsize = [1.5, 1.0, 1.2]\nposition = [0.75, 0.1, 0.0]\n", "")
    sms = scenario(write(tmp_path, text)).load()
    assert _mass(sms) == _mass(ffsms.load("satellite_ur5"))


@pytest.mark.parametrize(
    ("old", "new", "fragments"),
    [
        ("mass = 400.0", "mass = 0", ["[robot.mount] mass", "above zero"]),
        ("mass = 400.0", "mas = 4", ["unknown key 'mas' in [robot.mount]", "did you mean 'mass'"]),
        ("mass = 400.0", "inertia = [1.0, 1.0, 9.0]", ["[robot.mount] inertia", "triangle"]),
        ('"ur5"', '"ur55"', ["ur55"]),
        ("velocity = 0.4", 'wheels = ["a"]', ["[robot] wheels", "[wheels]"]),
        ("velocity = 0.4", 'end_effector = "tool9"', ["tool9"]),
    ],
)
def test_invalid_mounts_are_refused(tmp_path: Path, old: str, new: str, fragments: list[str]) -> None:
    with pytest.raises(FfsmsError) as caught:
        scenario(write(tmp_path, FILE.replace(old, new))).load()
    for fragment in fragments:
        assert fragment in str(caught.value)
