"""The functions `inspect` and `repair` for URDF files.

The rules are applied in turn to the parsed <robot>. Each fault is repaired before the next rule is applied,
so that it does not hide other faults.
"""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from ffsms_pin.checks import positive
from ffsms_pin.errors import FfsmsError, InvalidInertia, InvalidUrdf, InvalidValue
from ffsms_pin.files import write_content
from ffsms_pin.geometry.shapes import find_mesh
from ffsms_pin.inspection.faults import Change, Fault, Settings, number_faults
from ffsms_pin.inspection.inertias import inertia_faults, inertial_numbers, mass_faults, thicken
from ffsms_pin.inspection.joints import (
    declaration_faults,
    joint_faults,
    name_faults,
    root_faults,
    shape_faults,
)
from ffsms_pin.robot.building import LoadOptions, build, model_of, robot_file
from ffsms_pin.system.urdf_elements import MOVING, inertia_problem, read_robot
from ffsms_pin.system.urdf_file import DEFAULT_EFFORT, DEFAULT_RATE, UrdfFile, lenient


def thin_bodies(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find thin rods and point masses because of which `load` refuses a body."""
    refused = refusal(settings.path, robot)
    return thicken(robot, refused.link) if isinstance(refused, InvalidInertia) else iter(())


_RULES: tuple[Callable[[ElementTree.Element, Settings], Iterator[Fault]], ...] = (
    number_faults,
    name_faults,
    root_faults,
    joint_faults,
    inertia_faults,
    mass_faults,
    shape_faults,
    declaration_faults,
    thin_bodies,
)


class Examination(NamedTuple):
    """The faults of a <robot>, the repaired <robot>, and the error if `load` refuses the repaired <robot>."""

    faults: list[Fault]
    mended: ElementTree.Element
    refusal: FfsmsError | None


def examine(robot: ElementTree.Element, settings: Settings) -> Examination:
    """Find the faults of a <robot>, and repair it in place if possible."""
    faults: list[Fault] = []
    lasting: set[tuple[str, str]] = set()
    # A repair may cause another fault, such as a massless body that no longer carries a moving joint.
    for _ in range(len(robot) + 2):
        mends = 0
        for rule in _RULES:
            for fault in list(rule(robot, settings)):
                if fault.mend is not None:
                    fault.mend()
                    mends += 1
                elif (fault.where, fault.problem) in lasting:  # found again, because it has no repair
                    continue
                else:
                    lasting.add((fault.where, fault.problem))
                faults.append(fault)
        if not mends:
            break
    refused = refusal(settings.path, robot)
    if refused is not None and not any(fault.blocks and fault.mend is None for fault in faults):
        problem = refused.problem if isinstance(refused, InvalidUrdf) else str(refused)
        faults.append(Fault("file", problem, True))
    return Examination(faults, robot, refused)


def refusal(path: Path, robot: ElementTree.Element) -> FfsmsError | None:
    """Return the error that `load` raises for a robot, or None.

    If no joint moves, return the error of `Client.from_urdf`. If the tree has several last links, the end
    effector is the first of them.
    """
    try:
        copied = copy.deepcopy(robot)
        lenient(copied, path)
        urdf = UrdfFile(path, copied)
        if not any(joint.moves for joint in urdf.joints):  # the file describes a client
            model_of(urdf)
            return None
        build(urdf, LoadOptions(next(iter(urdf.tips()), urdf.root)))
    except FfsmsError as error:
        return error
    return None


@dataclass(frozen=True)
class LinkReport:
    """The values of a link in the file.

    Attributes
    ----------
    name : str
        Name of the link.
    mass : float or None
        Mass [kg]; None if it is missing or not a number.
    principal_inertias : tuple of float or None
        Principal inertias about the centre of mass, ascending [kg m^2]; None if they are missing or not
        numbers, or if the link has no mass.
    verdict : str
        "valid", "valid for a thin rod or a point only", "frame" (a link without mass), or a short name of the
        fault.
    """

    name: str
    mass: float | None
    principal_inertias: tuple[float, float, float] | None
    verdict: str


@dataclass(frozen=True)
class JointReport:
    """The values of a joint in the file; a limit is the text in the file, or None if it is missing."""

    name: str
    type: str
    lower: str | None
    upper: str | None
    velocity: str | None
    effort: str | None


@dataclass(frozen=True)
class Report:
    """The result of `inspect`.

    Attributes
    ----------
    path : Path
        The file.
    name : str
        The robot's name; empty if the file has none.
    loads : bool
        True if `ffsms_pin.load` accepts the file, or `ffsms_pin.Client.from_urdf` if no joint moves.
    refusal : str or None
        The message of the error that `load` or `Client.from_urdf` raises; None if there is none.
    repairable : bool
        True if `repair` can write a file that loads, also if the file already loads.
    moves : bool
        True if any joint moves after a repair. If no joint moves, the file describes a client, a single rigid
        body.
    links, joints : tuple of LinkReport, of JointReport
        The links and joints, in the order of the file.
    faults : tuple of Fault
        The faults, in the order in which they were found.
    """

    path: Path
    name: str
    loads: bool
    refusal: str | None
    repairable: bool
    moves: bool
    links: tuple[LinkReport, ...]
    joints: tuple[JointReport, ...]
    faults: tuple[Fault, ...]


def inspect(path: str | os.PathLike[str]) -> Report:
    """Inspect a URDF file without changing it.

    Parameters
    ----------
    path : str or path
        A file, or the name of a packaged robot.

    Raises
    ------
    ModelNotFound
        If the file does not exist.
    InvalidUrdf
        If the file cannot be read, or is not XML with a <robot> element.
    """
    file = robot_file(path, "path")
    robot = read_robot(file)
    refused = refusal(file, robot)
    examination = examine(copy.deepcopy(robot), Settings(file, DEFAULT_RATE, DEFAULT_EFFORT))
    return Report(
        file,
        robot.get("name", ""),
        refused is None,
        None if refused is None else str(refused),
        examination.refusal is None,
        any(joint.get("type") in MOVING for joint in examination.mended.findall("joint")),
        tuple(_link(link) for link in robot.findall("link")),
        tuple(_joint(joint) for joint in robot.findall("joint")),
        tuple(examination.faults),
    )


def _link(link: ElementTree.Element) -> LinkReport:
    name = link.get("name", "")
    mass, tensor = inertial_numbers(link)
    if link.find("inertial") is None or mass == 0.0:
        return LinkReport(name, mass, None, "frame")
    if mass is None or tensor is None:
        return LinkReport(name, mass, None, "incomplete, or not in numbers")
    a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
    verdict = "valid" if a > 0.0 else "valid for a thin rod or a point only"
    if mass < 0.0:
        verdict = "negative mass"
    elif problem := inertia_problem(tensor):
        verdict = {"negative": "not positive definite", "triangle": "breaks the triangle inequality"}[problem]
    return LinkReport(name, mass, (a, b, c), verdict)


def _joint(joint: ElementTree.Element) -> JointReport:
    limit = joint.find("limit")
    values = {} if limit is None else limit.attrib
    limits = (values.get(key) for key in ("lower", "upper", "velocity", "effort"))
    return JointReport(joint.get("name", ""), joint.get("type", ""), *limits)


def repair(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    rate: float = DEFAULT_RATE,
    effort: float = DEFAULT_EFFORT,
) -> list[Change]:
    """Write a URDF that `ffsms_pin.load` or `ffsms_pin.Client.from_urdf` accepts, and return the changes.

    The repair changes only faults that prevent loading, numbers that readers drop, entries for which `load`
    makes an assumption with a warning, and mesh paths that are relative to the old folder. If a fault
    that prevents loading cannot be repaired from the file alone (a negative mass, a base without mass, two
    roots), nothing is written.

    Parameters
    ----------
    path : str or path
        A file, or the name of a packaged robot. The file is not changed unless `out` is the same path.
    out : str or path
        The file to write. A comment at the beginning of its <robot> element lists the changes, if any.
    rate : float
        Rate limit for joints without a rate limit [rad/s or m/s].
    effort : float
        Torque or force limit for joints without such a limit [N m or N].

    Returns
    -------
    list of Change
        The changes; empty if none is needed.

    Raises
    ------
    InvalidUrdf
        If a fault cannot be repaired, or the file cannot be read.
    ModelNotFound, InvalidValue, ResultError
        If the file does not exist, an argument is invalid, or `out` cannot be written.
    """
    if not isinstance(out, (str, os.PathLike)):
        raise InvalidValue("out", out, "must be a path")
    settings = Settings(robot_file(path, "path"), positive("rate", rate), positive("effort", effort))
    examination = examine(read_robot(settings.path), settings)
    if examination.refusal is not None:
        stuck = [str(fault) for fault in examination.faults if fault.blocks and fault.mend is None]
        raise InvalidUrdf(settings.path, f"cannot be repaired: {'; '.join(stuck)}")
    mended = [fault for fault in examination.faults if fault.mend is not None]
    changes = [Change(fault.where, fault.problem, str(fault.remedy)) for fault in mended]
    changes += _move_meshes(examination.mended, settings.path, Path(out))
    if changes:
        # An XML comment must not contain two dashes in a row.
        comment_text = "\n".join(["Changed by ffsms-pin:", *(f"  {change}" for change in changes), ""])
        comment: Any = ElementTree.Comment(" " + re.sub("-(?=-)", "- ", comment_text))
        comment.tail = "\n"
        examination.mended.insert(0, comment)
    text = ElementTree.tostring(examination.mended, encoding="utf-8", xml_declaration=True)
    write_content(out, text)
    return changes


def _move_meshes(robot: ElementTree.Element, source: Path, out: Path) -> list[Change]:
    """Make mesh paths relative to the folder of `out` instead of `source`, and return the changes."""
    moved: dict[Change, None] = {}
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        path = find_mesh(name, source)
        if "://" in name or path is None or find_mesh(name, out) == path:
            continue
        new = Path(os.path.relpath(path, os.path.abspath(out.parent))).as_posix()
        mesh.set("filename", new)
        moved[Change("file", f"the mesh '{name}' is relative to the old folder", f"written as '{new}'")] = (
            None
        )
    return list(moved)
