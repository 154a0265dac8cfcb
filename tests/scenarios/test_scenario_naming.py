"""Errors of the library name the table and the key of the scenario file that they come from."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenario_files import QUICK, write

from ffsms_pin.errors import AmbiguousEndEffector, FfsmsError, InvalidScenario, InvalidUrdf
from ffsms_pin.scenarios import scenario
from ffsms_pin.scenarios.closed_loop import controller, prepared
from ffsms_pin.urdf import model_path

ON_A_SATELLITE = (
    QUICK.replace("planar_3r", "z1")
    .replace("[23.0, 40.0, -29.0]", "[0, 50, -50, 0, 0, 0]")
    .replace("offset_deg = [0.5, 0.0, -0.5]", "")
)
MOUNT = ON_A_SATELLITE + "[robot.mount]\n"
WHEELS = QUICK + "[wheels]\naxes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ninertia = 0.001\nmomentum = 1.0\n"
THRUSTERS = "[thrusters]\nplaces = [[0.2, 0, 0], [-0.2, 0, 0]]\ndirections = [[0, 1, 0], [0, 1, 0]]\n"
PUSHED = QUICK + THRUSTERS
DUMPED = WHEELS + THRUSTERS + "force = 1.0\nleast_on_time = 0.01\n[attitude]\n[attitude.dump]\n"
MET = QUICK.replace("[target]\nposition = [0.75, 0.5, 0.0]\n", "") + "[client]\nmass = 10.0\n"
PLACED = MET + "inertia = [1, 1, 1]\nposition = [1.0, 0.4, 0.0]\n"
TURNED = "[client.sensor]\n[reference]\nkind = 're-planning'\n[meet]\n"


def build(path: Path) -> None:
    """Build everything that a run builds before it plans."""
    read = scenario(path)
    sms = read.load()
    with read.named():
        q0 = read.start_configuration(sms)
        controller(read, sms)
        read.problem(sms, q0)
        prepared(read, sms, q0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MOUNT + "inertia = [1, 1, 9]\n", "[robot.mount] inertia violates the triangle inequality"),
        (
            QUICK.replace("[start]", "locked = {elbow = 0.5}\n[start]"),
            "[robot] locked must name moving joints of the arm",
        ),
        (QUICK.replace("[start]", "end_effector = 'tol'\n[start]"), "[robot] end_effector: no frame 'tol'"),
        (QUICK.replace('"planar_3r"', '"planar_4r"'), "[robot] model: no robot"),
        (QUICK + "[limits]\nlower = 2.0\n", "[limits] limits of joint 1"),
        (WHEELS.replace("[1, 0, 0]", "[0, 0, 0]"), "[wheels] axes must not contain a vector of length zero"),
        (
            PUSHED + "force = 1.0\n[attitude]\n",
            "[thrusters] period must be given, or least_on_time",
        ),
        (DUMPED + "above = 0.1\nbelow = 0.5\n", "[attitude.dump] must have 0 <= below < above"),
        (PLACED.replace("[1, 1, 1]", "[1, 1, 9]") + "[meet]\n", "[client] inertia violates the triangle"),
        (PLACED + "[meet]\naxis = [0, 0, 0]\n", "[meet] axis must not be zero, got (0.0, 0.0, 0.0)"),
        (
            PLACED + TURNED + "half_angle_deg = 170\n",
            "[meet] half_angle_deg must be below a right angle",
        ),
        (
            QUICK + "[plant]\nbase_mass = 2\n[plant.random]\nseed = 1\narm_mass = 2\n",
            "[plant.random] arm_mass",
        ),
        (QUICK + "[plant]\nmodel = 'none.urdf'\n", "[plant] model: no robot"),
        (QUICK + "[sensors]\nbase_latency = 9\n", "[sensors] base_latency must be below the run's duration"),
        (QUICK.replace("dt = 0.004", "dt = 9.0"), "[control] dt must not exceed"),
        (QUICK.replace("dt = 0.05", "locked = ['elbow']"), "[plan] locked must be one of the joints"),
    ],
)
def test_table_and_key_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(FfsmsError) as caught:
        build(path)
    assert str(caught.value).startswith(f"scenario {path}: {message}")


def test_an_error_about_a_default_names_no_key(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=r"toml: duration must be at least one step of 99 s"):
        build(write(tmp_path, QUICK.replace("duration = 3.0\ndt = 0.05", "dt = 99.0")))


def test_advice_names_the_key_and_not_python(tmp_path: Path) -> None:
    with pytest.raises(AmbiguousEndEffector, match=r"\[robot\] .*effector: \[robot\] end_effector = NAME$"):
        scenario(write(tmp_path, QUICK.replace('"planar_3r"', '"two_arms"'))).load()
    urdf = Path(model_path("planar_3r")).read_text("utf-8")
    (tmp_path / "slow.urdf").write_text(urdf.replace('velocity="', 'velocity="0" unused="'), encoding="utf-8")
    with pytest.raises(InvalidUrdf, match=r"\[robot\] velocity = \.\.\. sets it for all joints"):
        scenario(write(tmp_path, QUICK.replace('"planar_3r"', '"slow.urdf"'))).load()
