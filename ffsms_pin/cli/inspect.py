"""`ffsms-pin inspect`: what is in a URDF file, what is wrong with it, and a mended file."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ffsms_pin.cli.output import say
from ffsms_pin.inspection import Report, inspect, repair
from ffsms_pin.system.urdf_elements import is_number

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Print the report and, where it is asked for, write the mended file."""
    console = Console()
    report = inspect(arguments.file)
    console.print(_links(report))
    console.print(_joints(report))
    if report.faults:
        console.print(_faults(report))
    if report.loads:
        console.print("The file loads as it is.", highlight=False)
    else:
        console.print(
            f"load refuses the file: {escape(str(report.refusal))}", highlight=False, soft_wrap=True
        )
    if arguments.repair is None:
        if not report.loads and report.repairable:
            console.print("It can be mended: add --repair OUT.", highlight=False)
        return 0 if report.loads else 1
    given = {"rate": arguments.rate, "effort": arguments.effort}
    settings = {key: value for key, value in given.items() if value is not None}
    changes = repair(arguments.file, arguments.repair, **settings)
    count = f"{len(changes)} change{'' if len(changes) == 1 else 's'}" + (":" if changes else "")
    say(f"{arguments.repair} written, {count}", *(f"  {change}" for change in changes))
    return 0


def _links(report: Report) -> Table:
    table = Table(title=escape(f"Links of '{report.name}'"), title_justify="left")
    table.add_column("link")
    table.add_column(escape("mass [kg]"), justify="right")
    table.add_column(escape("principal inertias [kg m²]"), justify="right")
    table.add_column("inertia")
    for link in report.links:
        inertias = link.principal_inertias
        table.add_row(
            escape(link.name),
            "" if link.mass is None else f"{link.mass:.4g}",
            "" if inertias is None else ", ".join(f"{value:.4g}" for value in inertias),
            link.verdict if link.verdict in ("valid", "frame") else f"[red]{escape(link.verdict)}[/]",
        )
    return table


def _joints(report: Report) -> Table:
    table = Table(title="Joints, as written (rad, m, s, N)", title_justify="left")
    for name in ("joint", "type", "lower", "upper", "velocity", "effort"):
        table.add_column(name, justify="left" if name in ("joint", "type") else "right")
    for joint in report.joints:
        limits = (joint.lower, joint.upper, joint.velocity, joint.effort)
        nothing = "" if joint.type == "fixed" else "none"
        table.add_row(
            escape(joint.name),
            escape(joint.type),
            *(nothing if value is None else _number(value) for value in limits),
        )
    return table


def _number(text: str) -> str:
    """A number, shortened; anything else as it is written."""
    return f"{float(text):.5g}" if is_number(text) else escape(text)


def _faults(report: Report) -> Table:
    table = Table(title="Faults", title_justify="left")
    table.add_column("where", overflow="fold")
    table.add_column("what", overflow="fold")
    table.add_column("loads?")
    table.add_column("repair")
    for fault in sorted(report.faults, key=lambda fault: not fault.blocks):
        remedy = fault.remedy or (
            "not possible: the author must say" if fault.blocks else "none needed to load"
        )
        table.add_row(
            escape(fault.where),
            escape(fault.problem),
            "[red]no[/]" if fault.blocks else "yes",
            escape(remedy),
        )
    return table
