"""Captures with wheels, thrusters or neither, under each joint law, of a known or a measured client."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import CAPTURE, write

import ffsms_pin as ffsms
from ffsms_pin import capture, opt, scenarios
from ffsms_pin.control import SlidingModeController, StationKeeping
from ffsms_pin.scenarios.definition import packaged_path
from ffsms_pin.scenarios.problems import rendezvous

PLACES = np.repeat([[0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]], 2, axis=0)
DIRECTIONS = np.repeat([[0, 0, 1], [1, 0, 0], [0, 1, 0]], 4, axis=0) * np.tile([1, -1], 6)[:, None]
WHEELS = """
[wheels]
axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
inertia = 0.05
momentum = {0}
torque = {1}
"""
THRUSTERS = f"""
[thrusters]
places = {PLACES.tolist()}
directions = {DIRECTIONS.tolist()}
force = 5.0
proportional = true
"""
WEAK = WHEELS.format(60.0, 1.0)
# The mode of the plan and the tables of the base actuators, by name.
BASES = {
    "none": ("floating", ""),
    "idle wheels": ("floating", WEAK),
    "wheels": ("rotation-floating", f"{WEAK}[attitude]\n"),
    "coordinated wheels": ("rotation-floating", f'{WEAK}[attitude]\nlaw = "coordinated"\n'),
    "thrusters": ("rotation-flying", f"{THRUSTERS}[attitude]\n"),
    "held place": (
        "translation-flying",
        f'{THRUSTERS}[attitude]\nlaw = "station-keeping"\nholds = "place"\n',
    ),
    "held place and attitude": ("flying", f'{THRUSTERS}[attitude]\nlaw = "station-keeping"\n'),
    "wheels and thrusters": ("rotation-floating", f"{WEAK}{THRUSTERS}[attitude]\n[attitude.dump]\n"),
}
LAWS = {
    "computed-torque": "K_p = 100.0\nK_d = 20.0\n",
    "sliding-mode": "",
    "impedance": "",
    "admittance": "",
}
MEASURED = """\
[client.sensor]
position_noise = 0.002
attitude_noise_deg = 0.3
velocity_noise = 0.002
rate_noise_deg = 0.1
latency = 0.2
period = 0.1
[reference]
kind = "re-planning"
period = 0.5
[meet]
"""
COMPLIANT = '[contact]\nkind = "compliant"\nstiffness = 500.0\ndamping = 50.0\n'

pytestmark = [pytest.mark.slow, pytest.mark.long]


def _text(base: str, law: str, measured: bool, compliant: bool) -> str:
    """Return the text of the scenario of a combination."""
    mode, tables = BASES[base]
    text = CAPTURE.replace("dt = 0.02", f'dt = 0.05\nmode = "{mode}"').replace("after = 4.0", "after = 2.0")
    text = re.sub(r"\[control\][^\[]*", f'[control]\nlaw = "{law}"\n{LAWS[law]}dt = 0.005\n', text)
    if measured:
        text = text.replace("[meet]\n", MEASURED).replace("duration = 6.0", "duration = 8.0")
    if compliant:
        text = text.replace("[contact]\n", COMPLIANT)
    return text + tables + ("[wrist]\n" if law == "admittance" else "")


def _captured(folder: Path, text: str) -> Any:
    outcome = scenarios.run(scenarios.scenario(write(folder, text)))
    assert outcome.capture is not None
    return outcome.capture


@pytest.mark.parametrize(
    ("base", "law", "measured", "compliant"),
    [
        ("none", "sliding-mode", True, False),
        ("idle wheels", "impedance", False, True),
        ("wheels", "computed-torque", True, True),
        ("coordinated wheels", "computed-torque", False, False),
        ("thrusters", "sliding-mode", False, True),
        ("held place", "admittance", False, True),
        ("held place and attitude", "impedance", True, False),
        ("wheels and thrusters", "computed-torque", False, False),
    ],
)
def test_a_client_is_caught(tmp_path: Path, base: str, law: str, measured: bool, compliant: bool) -> None:
    record = _captured(tmp_path, _text(base, law, measured, compliant))
    assert record.caught, record.missed
    assert record.whole.arrived, record.whole.note
    assert record.closings[-1].miss[0] < 3e-3
    assert record.momentum_error < 1e-6
    rate = np.degrees(np.linalg.norm(record.found_rate))
    if base in ("none", "idle wheels", "held place"):  # the base turns with the client's momentum
        assert rate > 0.2
    else:
        assert rate < 2e-3


def test_idle_wheels_do_not_change_a_capture(tmp_path: Path) -> None:
    with_wheels, plain = (
        _captured(tmp_path, _text(base, "computed-torque", False, False)) for base in ("idle wheels", "none")
    )
    np.testing.assert_array_equal(with_wheels.whole.q, plain.whole.q)


def test_thrusters_from_python_and_from_a_file_give_the_same_capture(tmp_path: Path) -> None:
    path = write(tmp_path, _text("held place and attitude", "sliding-mode", False, False))
    outcome = scenarios.run(scenarios.scenario(path))
    thrusters = ffsms.Thrusters(PLACES, DIRECTIONS, 5.0, proportional=True)
    sms = ffsms.load("satellite_panda").with_actuators(thrusters=thrusters)
    meeting = rendezvous(outcome.scenario, outcome.sms)
    flight = capture.fly(
        sms,
        meeting.q0,
        opt.Meet(meeting.client, meeting.goal.grasp, standoff=0.05),
        6.0,
        control=capture.Control(SlidingModeController, StationKeeping, dt=0.005),
        planning=capture.Planning(dt=0.05, mode="flying"),
        procedure=capture.Procedure(after=2.0),
    )
    assert flight.latched
    assert outcome.capture is not None
    np.testing.assert_array_equal(flight.tracking.q, outcome.capture.whole.q)
    np.testing.assert_array_equal(flight.tracking.thruster_force, outcome.capture.whole.thruster_force)


def test_wheels_hold_a_servicer_whose_probe_enters_a_nozzle(tmp_path: Path) -> None:
    """Use the packaged client without measurement errors, and wheels as strong as the arm requires."""
    text = packaged_path("nozzle").read_text("utf-8")
    for name in ("client.sensor", "client.belief", "reference"):
        text = re.sub(rf"^\[{re.escape(name)}\]\n(?:[^\[\n].*\n|\n)*", "", text, flags=re.M)
    start = "[30.0, -35.0, -40.0, 115.0, 25.0, -60.0, -80.0]"
    assert start in text
    text = text.replace(start, "[0.0, -20.0, -20.0, 90.0, 20.0, -60.0, -60.0]")
    text = text.replace("half_angle_deg = 3.0", "half_angle_deg = 6.0").replace("dt = 0.005 ", "dt = 0.01 ")
    text = text.replace("after = 10.0", "after = 2.0")
    text = text.replace("[plan]\n", '[plan]\nmode = "rotation-floating"\n')
    record = _captured(tmp_path, f"{text}{WHEELS.format(2000.0, 20.0)}[attitude]\n")
    assert record.caught, record.missed
    assert np.degrees(np.linalg.norm(record.found_rate)) < 0.1
