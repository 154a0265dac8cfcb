"""Goes through a URDF with all rules, mending a copy as it goes, so that no fault hides behind another."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from ffsms_pin.errors import FfsmsError, InvalidInertia, InvalidUrdf
from ffsms_pin.inspection.faults import Fault, Settings
from ffsms_pin.inspection.inertias import inertia_faults, mass_faults, thicken
from ffsms_pin.inspection.joints import joint_faults, name_faults, root_faults, shape_faults
from ffsms_pin.inspection.numbers import number_faults
from ffsms_pin.system.loading import build
from ffsms_pin.system.urdf_elements import read_robot
from ffsms_pin.system.urdf_file import UrdfFile
from ffsms_pin.system.urdf_leniency import lenient

_RULES: tuple[Callable[[ElementTree.Element, Settings], Iterator[Fault]], ...] = (
    number_faults,
    name_faults,
    root_faults,
    joint_faults,
    inertia_faults,
    mass_faults,
    shape_faults,
)


class Examination(NamedTuple):
    """What was found, the robot as it is after every mend, and why the strict reader refuses that, if so."""

    faults: list[Fault]
    mended: ElementTree.Element
    refusal: FfsmsError | None


def examine(settings: Settings) -> Examination:
    """Find the faults of a file and mend those that can be, in memory."""
    robot = read_robot(settings.path)
    faults: list[Fault] = []
    lasting: set[tuple[str, str]] = set()
    # Mending a joint may uncover another: a body without mass beyond which nothing moves any more.
    for _ in range(len(robot.findall("joint")) + 2):
        mends = 0
        for rule in _RULES:
            for fault in list(rule(robot, settings)):
                if fault.mend is not None:
                    fault.mend()
                    mends += 1
                elif (fault.where, fault.problem) in lasting:  # what cannot be mended is found on every pass
                    continue
                else:
                    lasting.add((fault.where, fault.problem))
                faults.append(fault)
        if not mends:
            break
    refused = refusal(settings.path, robot)
    for _ in range(len(robot.findall("link"))):
        if not isinstance(refused, InvalidInertia):
            break
        thin = list(thicken(robot, refused.link))
        if not thin:
            break
        for fault in thin:
            assert fault.mend is not None
            fault.mend()
        faults += thin
        refused = refusal(settings.path, robot)
    if refused is not None and not any(fault.blocks and fault.mend is None for fault in faults):
        problem = refused.problem if isinstance(refused, InvalidUrdf) else str(refused)
        faults.append(Fault("file", problem, True))
    return Examination(faults, robot, refused)


def refusal(path: Path, robot: ElementTree.Element) -> FfsmsError | None:
    """Why `load` refuses this robot, or None; any of several last links may be the end effector."""
    try:
        copied = copy.deepcopy(robot)
        lenient(copied, path)
        urdf = UrdfFile(path, copied)
        build(urdf, next(iter(urdf.tips()), urdf.root))
    except FfsmsError as error:
        return error
    return None
