"""The command `ffsms-pin export`: a robot as a file for other tools."""

from __future__ import annotations

import argparse

from ffsms_pin.cli.output import say
from ffsms_pin.errors import InvalidValue
from ffsms_pin.export import to_mjcf, to_urdf
from ffsms_pin.files import write_content
from ffsms_pin.robot import load
from ffsms_pin.scenarios import scenario, scenario_names


def run(arguments: argparse.Namespace) -> int:
    """Write the robot as a URDF or as a MuJoCo model."""
    name = arguments.model
    if name.endswith(".toml") or name in scenario_names():
        if arguments.end_effector is not None:
            remedy = "is for a robot; in a scenario set [robot] end_effector in its file"
            raise InvalidValue("--end-effector", arguments.end_effector, remedy)
        sms = scenario(name).load()
    else:
        sms = load(name, end_effector=arguments.end_effector)
    tool = sms.end_effector
    if arguments.mjcf is not None:
        write_content(arguments.mjcf, to_mjcf(sms))
        say(f"MuJoCo model: {arguments.mjcf}; its site 'end_effector' is at the frame '{tool}'")
    else:
        to_urdf(sms, arguments.urdf)
        say(f"URDF: {arguments.urdf}; its end effector is '{tool}'")
    return 0
