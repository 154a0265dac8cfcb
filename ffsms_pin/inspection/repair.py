"""`repair`: a URDF that loads, written anew, with every change listed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ffsms_pin.checks import positive
from ffsms_pin.errors import InvalidUrdf, InvalidValue
from ffsms_pin.inspection.examination import examine
from ffsms_pin.inspection.faults import Change, Settings
from ffsms_pin.inspection.report import checked_path
from ffsms_pin.storage import write_content
from ffsms_pin.system.shapes import find_mesh
from ffsms_pin.system.urdf_leniency import DEFAULT_EFFORT, DEFAULT_RATE

__all__ = ["repair"]


def repair(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    rate: float = DEFAULT_RATE,
    effort: float = DEFAULT_EFFORT,
) -> list[Change]:
    """Write a URDF that `ffsms_pin.load` takes, and say what was changed.

    Only what keeps a file from loading is mended, numbers that readers drop, and what `load` assumes with a
    warning. Where it takes knowledge that the file does not hold (a negative mass, a base without mass, two
    roots), nothing is written.

    Parameters
    ----------
    path : str or path
        The file to mend; it is left alone unless `out` is the same.
    out : str or path
        The file to write; the changes stand in a comment at its head too.
    rate : float
        Rate limit for joints without one [rad/s or m/s].
    effort : float
        Torque or force limit for joints without one [N m or N].

    Returns
    -------
    list of Change
        Empty where the file loads as it is: `out` is then a plain copy in content.

    Raises
    ------
    InvalidUrdf
        Something is wrong that cannot be mended.
    ModelNotFound, InvalidValue, ResultError
        There is no such file, `rate` or `effort` cannot be used, or `out` cannot be written.
    """
    if not isinstance(out, (str, os.PathLike)):
        raise InvalidValue("out", out, "must be a path")
    settings = Settings(checked_path(path), positive("rate", rate), positive("effort", effort))
    found = examine(settings)
    if found.refusal is not None:
        stuck = [str(fault) for fault in found.faults if fault.blocks and fault.mend is None]
        raise InvalidUrdf(settings.path, f"cannot be mended: {'; '.join(stuck)}")
    mended = [fault for fault in found.faults if fault.mend is not None]
    changes = [Change(fault.where, fault.problem, str(fault.remedy)) for fault in mended]
    changes += _move_meshes(found.mended, settings.path, Path(out))
    if changes:
        # Two dashes would end a comment.
        told = "\n".join(["Changed by ffsms-pin:", *(f"  {change}" for change in changes), ""])
        comment: Any = ElementTree.Comment(" " + told.replace("--", "- -"))
        comment.tail = "\n"
        found.mended.insert(0, comment)
    text = ElementTree.tostring(found.mended, encoding="utf-8", xml_declaration=True)
    write_content(out, text)
    return changes


def _move_meshes(robot: ElementTree.Element, source: Path, out: Path) -> list[Change]:
    """Mesh names that count from the file's folder, for a file in another folder."""
    moved: dict[Change, None] = {}
    for mesh in robot.iter("mesh"):
        name = mesh.get("filename", "")
        found = find_mesh(name, source)
        if "://" in name or found is None or find_mesh(name, out) == found:
            continue
        new = Path(os.path.relpath(found, os.path.abspath(out.parent))).as_posix()
        mesh.set("filename", new)
        moved[Change("file", f"the mesh '{name}' counts from the old folder", f"written as '{new}'")] = None
    return list(moved)
