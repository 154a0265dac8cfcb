"""The command `ffsms-pin info`: masses, limits and coupling of a robot, and the faults of its file."""

from __future__ import annotations

import argparse
import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table

from ffsms_pin.checks import FloatArray, vector
from ffsms_pin.cli.main import in_options, named
from ffsms_pin.cli.output import limit_text, new_table, output_console, range_text, say
from ffsms_pin.client import Client
from ffsms_pin.errors import FfsmsWarning, InvalidValue
from ffsms_pin.inspection import Report, inspect, repair
from ffsms_pin.robot import SpaceManipulator, load, satellite_names
from ffsms_pin.robot.building import is_mjcf
from ffsms_pin.system.urdf_elements import is_number
from ffsms_pin.urdf import model_names


def run(arguments: argparse.Namespace) -> int:
    """Print the faults of a robot file and the robot's tables; write the repaired file on request."""
    console = output_console()
    robot = arguments.model
    path = Path(os.path.expanduser(robot))
    is_urdf = robot in model_names() or (path.is_file() and not is_mjcf(path))
    report = inspect(robot) if is_urdf else None
    for name in ("rate", "effort"):
        if arguments.repair is None and (value := getattr(arguments, name)) is not None:
            raise InvalidValue(f"--{name}", value, "needs --repair OUT, because it is for the repaired file")
    if robot in satellite_names() and arguments.repair is not None:
        raise InvalidValue("MODEL", robot, "must be a URDF file if --repair is given")
    if report is not None and report.faults:
        console.print(_faults(report))
    if arguments.repair is not None:
        changes = repair(robot, arguments.repair, **named(arguments, "rate", "effort"))
        count = f"{len(changes)} change{'' if len(changes) == 1 else 's'}" + (":" if changes else "")
        say(f"{arguments.repair} written, {count}", *(f"  {change}" for change in changes))
        robot = arguments.repair
    elif report is not None and not report.loads:
        console.print(_links(report))
        console.print(_joints(report))
        say(
            f"The file does not load, so its coupling is not shown: {in_options(report.refusal or '')}",
            *(["It can be repaired: add --repair OUT."] if report.repairable else []),
        )
        return 1
    if report is not None and not report.moves:
        for name in ("joints_deg", "end_effector"):
            if (value := getattr(arguments, name)) is not None:
                option = f"--{name.replace('_', '-')}"
                raise InvalidValue(option, value, f"needs a robot, but no joint of '{robot}' moves")
        say(*_client(robot))
        return 0
    with warnings.catch_warnings():
        if report is not None:  # the printed faults replace the warnings
            warnings.simplefilter("ignore", FfsmsWarning)
        sms = load(robot, end_effector=arguments.end_effector)
    posture = _posture(sms, arguments.joints_deg)
    size = "none" if sms.base_size is None else " x ".join(f"{edge:g}" for edge in sms.base_size) + " m"
    say(f"{sms.model.name}: {sms.n} joints, end effector '{sms.end_effector}', base box {size}")
    console.print(_bodies(sms))
    console.print(_limits(sms))
    if np.any([sms.model.armature[6:], sms.joint_damping, sms.joint_friction]):
        console.print(_friction(sms))
    console.print(_coupling(sms, posture))
    return 0


def _client(path: str) -> list[str]:
    """Return lines about the single rigid body of a file without moving joints."""
    client = Client.from_urdf(os.path.expanduser(path))
    inertias = ", ".join(f"{x:.4g}" for x in np.linalg.eigvalsh(client.inertia))
    com = ", ".join(f"{x + 0.0:.4g}" for x in -client.link_placement.translation)
    return [
        f"No joint moves: one rigid body of {client.mass:g} kg, a client.",
        f"Principal inertias {inertias} kg m²; centre of mass at ({com}) m in the frame of its root link.",
    ]


def _posture(sms: SpaceManipulator, joints_deg: Sequence[float] | None) -> FloatArray:
    """Return the posture (n,) [rad or m] for the coupling; the help of --joints-deg states the default."""
    if joints_deg is not None:
        if not sms.layout.turns.all():
            sliding = sms.joint_names[int(np.argmin(sms.layout.turns))]
            remedy = f"must be left out, because joint '{sliding}' is prismatic"
            raise InvalidValue("--joints-deg", list(joints_deg), remedy)
        return np.radians(vector("--joints-deg", joints_deg, sms.n, "deg"))
    lower, upper = sms.limits.lower, sms.limits.upper
    inside = (lower <= 0.0) & (upper >= 0.0)
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (lower + upper)
    return np.where(inside, 0.0, np.where(np.isfinite(middle), middle, np.clip(0.0, lower, upper)))


def _bodies(sms: SpaceManipulator) -> Table:
    heads = ("body", "mass [kg]", "share", "principal inertias [kg m²]")
    table = new_table("Bodies (each with the links that are fixed to it)", *heads)
    inertias = list(sms.model.inertias)[1:]
    total = sum(float(body.mass) for body in inertias)
    for j, body in enumerate(inertias, start=1):
        principal = np.linalg.eigvalsh(body.inertia)
        table.add_row(
            escape(sms.layout.body_name(sms.model, j)),
            f"{body.mass:.4g}",
            f"{body.mass / total:.1%}",
            ", ".join(f"{value:.4g}" for value in principal),
        )
    table.add_section()
    table.add_row("whole system", f"{total:.4g}", "", "")
    return table


def _limits(sms: SpaceManipulator) -> Table:
    table = new_table("Joint limits", "joint", "position", "rate", "acceleration", "torque")
    limits = sms.limits
    for i, (name, (unit, factor)) in enumerate(zip(sms.joint_names, sms.layout.units, strict=True)):
        turns = unit == "deg"
        lines = [(name, "rad", 1.0), ("", "deg", factor)] if turns else [(name, "m", 1.0)]
        for label, written, times in lines:
            table.add_row(
                escape(label),
                range_text(times * limits.lower[i], times * limits.upper[i], written),
                limit_text(times * limits.velocity[i], f"{written}/s"),
                limit_text(times * limits.acceleration[i], f"{written}/s²"),
                limit_text(limits.torque[i], "N m" if turns else "N") if label else "",
            )
    return table


def _friction(sms: SpaceManipulator) -> Table:
    """Return the table of the joints' armature, damping and friction."""
    table = new_table("Joint friction", "joint", "armature", "damping", "dry friction")
    armature, damping, dry = sms.model.armature[6:], sms.joint_damping, sms.joint_friction
    for i, (name, turns) in enumerate(zip(sms.joint_names, sms.layout.turns, strict=True)):
        units = ("kg m²", "N m s/rad", "N m") if turns else ("kg", "N s/m", "N")
        values = (armature[i], damping[i], dry[i])
        table.add_row(escape(name), *(f"{x:.4g} {unit}" for x, unit in zip(values, units, strict=True)))
    return table


def _coupling(sms: SpaceManipulator, posture: FloatArray) -> Table:
    state = sms.at(sms.configuration(posture))
    units = sms.layout.units
    positions = [f"{x * factor:.3g} {unit}" for x, (unit, factor) in zip(posture, units, strict=True)]
    table = new_table(f"Dynamic coupling at joints ({', '.join(positions)})", "quantity", "value")
    effector = ", ".join(f"{x:.5f}" for x in state.end_effector_pose.translation)
    base = ", ".join(f"{x:.5f}" for x in state.base_pose.translation)
    sigma = ", ".join(f"{value:.4g}" for value in state.coupling.sigma)
    entropy = state.coupling.entropy
    for quantity, value in (
        ("end effector, from the system's centre of mass [m]", effector),
        ("base centre of mass, from the system's centre of mass [m]", base),
        ("condition number of H_b (mixes kg and kg m²) [-]", f"{np.linalg.cond(state.H_b):.4g}"),
        ("singular values of C_bm [m/rad, rad/rad]", sigma),
        ("entropy H_norm [-]", f"{entropy:.4f}"),
        ("1 - H_norm, approximately cos(theta_a) at zero cost [-]", f"{1.0 - entropy:.4f}"),
        ("condition number of H_q [-]", f"{np.linalg.cond(state.H_q):.4g}"),
    ):
        table.add_row(escape(quantity), value)  # units in brackets are not markup
    return table


def _links(report: Report) -> Table:
    heads = ("link", "mass [kg]", "principal inertias [kg m²]", "inertia")
    table = new_table(f"Links of '{report.name}'", *heads, text_columns=("inertia",))
    for link in report.links:
        table.add_row(
            escape(link.name),
            "" if link.mass is None else f"{link.mass:.4g}",
            ", ".join(f"{value:.4g}" for value in link.principal_inertias or ()),
            link.verdict if link.verdict in ("valid", "frame") else f"[red]{escape(link.verdict)}[/]",
        )
    return table


def _joints(report: Report) -> Table:
    heads = ("joint", "type", "lower", "upper", "velocity", "effort")
    table = new_table("Joints, as in the file (rad, m, s, N)", *heads, text_columns=("type",))
    for joint in report.joints:
        limits = (joint.lower, joint.upper, joint.velocity, joint.effort)
        nothing = "" if joint.type == "fixed" else "none"
        written = (nothing if value is None else _number(value) for value in limits)
        table.add_row(escape(joint.name), escape(joint.type), *written)
    return table


def _number(text: str) -> str:
    """Return a number with five significant digits, and any other text with its markup escaped."""
    return f"{float(text):.5g}" if is_number(text) else escape(text)


def _faults(report: Report) -> Table:
    heads = ("place", "fault", "loads?", "repair")
    table = new_table("Faults", *heads, text_columns=heads)
    for fault in sorted(report.faults, key=lambda fault: not fault.blocks):
        otherwise = "not possible: only the author has the value" if fault.blocks else "not needed to load"
        loads = "[red]no[/]" if fault.blocks else "yes"
        table.add_row(escape(fault.where), escape(fault.problem), loads, escape(fault.remedy or otherwise))
    return table
