"""`ffsms-pin info`, `inspect` and `export`: masses, limits, coupling, what is in a file, and files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from rich.markup import escape
from rich.table import Table

from ffsms_pin.checks import FloatArray, vector
from ffsms_pin.cli.main import in_options, named
from ffsms_pin.cli.output import limit_text, new_table, output_console, range_text, say
from ffsms_pin.errors import InvalidValue
from ffsms_pin.inspection import Report, inspect, repair
from ffsms_pin.interchange import to_mjcf, to_urdf
from ffsms_pin.models import load
from ffsms_pin.scenarios import scenario, scenario_names
from ffsms_pin.storage import write_content
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.urdf_elements import is_number


def info(arguments: argparse.Namespace) -> int:
    """Print what is known about the robot."""
    sms = load(arguments.model, end_effector=arguments.end_effector)
    posture = _posture(sms, arguments.joints_deg)
    console = output_console()
    size = "none" if sms.base_size is None else " x ".join(f"{edge:g}" for edge in sms.base_size) + " m"
    say(f"{sms.model.name}: {sms.n} joints, end effector '{sms.end_effector}', base box {size}")
    console.print(_bodies(sms))
    console.print(_limits(sms))
    console.print(_coupling(sms, posture))
    return 0


def _posture(sms: SpaceManipulator, joints_deg: Sequence[float] | None) -> FloatArray:
    if joints_deg is not None:
        if not sms.layout.turns.all():
            raise InvalidValue("--joints-deg", list(joints_deg), "cannot be used: a joint slides")
        return np.radians(vector("--joints-deg", joints_deg, sms.n, "deg"))
    lower, upper = sms.limits.lower, sms.limits.upper
    inside = (lower <= 0.0) & (upper >= 0.0)
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (lower + upper)
    return np.where(inside, 0.0, np.where(np.isfinite(middle), middle, np.clip(0.0, lower, upper)))


def _bodies(sms: SpaceManipulator) -> Table:
    heads = ("body", "mass [kg]", "share", "principal inertias [kg m²]")
    table = new_table("Bodies (with what is fixed to them)", *heads)
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


def _coupling(sms: SpaceManipulator, posture: FloatArray) -> Table:
    state = sms.at(sms.configuration(posture))
    units = sms.layout.units
    where = ", ".join(f"{x * factor:.3g} {unit}" for x, (unit, factor) in zip(posture, units, strict=True))
    table = new_table(f"Dynamic coupling at joints ({where})", "quantity", "value")
    effector = ", ".join(f"{x:.5f}" for x in state.end_effector_pose.translation)
    base = ", ".join(f"{x:.5f}" for x in state.base_pose.translation)
    sigma = ", ".join(f"{value:.4g}" for value in state.coupling.sigma)
    entropy = state.coupling.entropy
    for quantity, value in (
        ("end effector, from the system's centre of mass [m]", effector),
        ("base centre of mass, likewise [m]", base),
        ("condition number of H_b (mixes kg and kg m²) [-]", f"{np.linalg.cond(state.H_b):.4g}"),
        ("singular values of C_bm [m/rad, rad/rad]", sigma),
        ("entropy H_norm [-]", f"{entropy:.4f}"),
        ("1 - H_norm, which the cost compares with [-]", f"{1.0 - entropy:.4f}"),
        ("condition number of H_q [-]", f"{np.linalg.cond(state.H_q):.4g}"),
    ):
        table.add_row(escape(quantity), value)  # what stands in brackets is no markup
    return table


def inspected(arguments: argparse.Namespace) -> int:
    """Print the report and, where it is asked for, write the mended file."""
    console = output_console()
    report = inspect(arguments.file)
    console.print(_links(report))
    console.print(_joints(report))
    if report.faults:
        console.print(_faults(report))
    refusal = f"load refuses the file: {in_options(report.refusal or '')}"
    say("The file loads as it is." if report.loads else refusal)
    if arguments.repair is None:
        if not report.loads and report.repairable:
            say("It can be mended: add --repair OUT.")
        return 0 if report.loads else 1
    changes = repair(arguments.file, arguments.repair, **named(arguments, "rate", "effort"))
    count = f"{len(changes)} change{'' if len(changes) == 1 else 's'}" + (":" if changes else "")
    say(f"{arguments.repair} written, {count}", *(f"  {change}" for change in changes))
    return 0


def exported(arguments: argparse.Namespace) -> int:
    """Write the robot as a file for other tools."""
    name = arguments.model
    if name.endswith(".toml") or name in scenario_names():
        if arguments.end_effector is not None:
            words = "is for a robot: that of a scenario is [robot] end_effector in its file"
            raise InvalidValue("--end-effector", arguments.end_effector, words)
        sms = scenario(name).load()
    else:
        sms = load(name, end_effector=arguments.end_effector)
    if arguments.mjcf is not None:
        write_content(arguments.mjcf, to_mjcf(sms))
        say(f"MuJoCo model: {arguments.mjcf}; its site 'end_effector' is '{sms.end_effector}'")
    else:
        to_urdf(sms, arguments.urdf)
        say(f"URDF: ffsms_pin.load('{arguments.urdf}', end_effector='{sms.end_effector}') reads it again")
    return 0


def _links(report: Report) -> Table:
    heads = ("link", "mass [kg]", "principal inertias [kg m²]", "inertia")
    table = new_table(f"Links of '{report.name}'", *heads, words=("inertia",))
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
    table = new_table("Joints, as written (rad, m, s, N)", *heads, words=("type",))
    for joint in report.joints:
        limits = (joint.lower, joint.upper, joint.velocity, joint.effort)
        nothing = "" if joint.type == "fixed" else "none"
        written = (nothing if value is None else _number(value) for value in limits)
        table.add_row(escape(joint.name), escape(joint.type), *written)
    return table


def _number(text: str) -> str:
    """A number, shortened; anything else as it is written."""
    return f"{float(text):.5g}" if is_number(text) else escape(text)


def _faults(report: Report) -> Table:
    heads = ("where", "what", "loads?", "repair")
    table = new_table("Faults", *heads, words=heads)
    for fault in sorted(report.faults, key=lambda fault: not fault.blocks):
        otherwise = "not possible: the author must say" if fault.blocks else "none needed to load"
        loads = "[red]no[/]" if fault.blocks else "yes"
        table.add_row(escape(fault.where), escape(fault.problem), loads, escape(fault.remedy or otherwise))
    return table
