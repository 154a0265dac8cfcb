"""Faults of masses and inertias; see `ffsms_pin.system.urdf_elements` for what a rigid body can have."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from xml.etree import ElementTree

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.inspection.faults import Fault, Settings
from ffsms_pin.system import urdf_elements as urdf

_ALUMINIUM = 2700.0  # [kg/m^3]


def inertial_numbers(link: ElementTree.Element) -> tuple[float | None, FloatArray | None]:
    """Mass [kg] and inertia (3, 3) [kg m^2] of a link; None for what is not there or is no number."""
    mass, inertial = link.find("inertial/mass"), link.find("inertial")
    kilograms = None
    if mass is not None and urdf.is_number(mass.get("value", "")):
        kilograms = float(mass.get("value", ""))
    return kilograms, None if inertial is None else urdf.tensor_of(inertial)


def inertia_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Inertias that no rigid body has, and inertials that lack a part."""
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        where, element = f"link '{link.get('name', '')}'", inertial.find("inertia")
        mass, tensor = inertial_numbers(link)
        if inertial.find("mass") is None:
            yield Fault(where, "its <inertial> has no <mass>", True)
        elif mass is not None and mass < 0.0:
            yield Fault(where, f"its mass is negative, {mass:g} kg", True)
        elif element is None:
            if mass:
                problem, remedy = "its <inertial> has no <inertia>", "that of a solid aluminium sphere"
                mend = partial(urdf.set_inertia, inertial, solid_sphere(mass))
                yield Fault(where, problem, True, f"{remedy} of {mass:g} kg", mend)
            elif mass == 0.0:
                problem, mend = "its <inertial> has no mass and no <inertia>", partial(link.remove, inertial)
                yield Fault(where, problem, True, "<inertial> taken out", mend)
        elif missing := [key for key in urdf.INERTIA_KEYS if key not in element.attrib]:
            problem = f"its <inertia> has no {', '.join(missing)}"
            if all(
                i != j for i, j in (urdf.INERTIA_KEYS[key] for key in missing)
            ):  # products of inertia alone
                mend = partial(element.attrib.update, dict.fromkeys(missing, "0"))
                yield Fault(where, problem, True, "set to zero", mend)
            else:
                yield Fault(where, problem, True)
        elif tensor is not None:
            yield from _tensor_faults(inertial, tensor, where)


def _tensor_faults(inertial: ElementTree.Element, tensor: FloatArray, where: str) -> Iterator[Fault]:
    kind = urdf.inertia_problem(tensor)
    if kind is None:
        return
    if kind == "negative":
        problem = (
            f"its inertia is not positive definite: principal inertias {urdf.principal_text(tensor)} kg m^2"
        )
    else:
        a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
        problem = f"its inertia breaks the triangle inequality: {a:.6g} + {b:.6g} < {c:.6g} kg m^2"
    nearest = urdf.nearest_inertia(tensor, 0.0)
    remedy = f"nearest inertia of a rigid body: principal {urdf.principal_text(nearest)} kg m^2"
    yield Fault(where, problem, True, remedy, partial(urdf.set_inertia, inertial, nearest))


def mass_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Bodies that move, or are the base, without any mass."""
    fixed, moving = _carried(robot)
    joint_of: dict[str, ElementTree.Element] = {}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None or child.get("link", "") in joint_of:
            return  # not a tree: the strict check says so
        joint_of[child.get("link", "")] = joint
    weights = {link.get("name", ""): inertial_numbers(link)[0] for link in robot.findall("link")}
    for name in weights:
        carrier = joint_of.get(name)
        if carrier is not None and carrier.get("type") not in urdf.MOVING:
            continue
        group = urdf.reached(name, fixed)
        if any(weights.get(link) for link in group):
            continue
        if carrier is None:
            problem = "the base has no mass; a satellite needs one: put the arm on one with ffsms_pin.mount"
            yield Fault(f"link '{name}'", problem, True)
        elif any(moving.get(link) for link in group):
            yield Fault(f"link '{name}'", "it moves, and carries further joints, but has no mass", True)
        else:
            where = f"joint '{carrier.get('name', '')}'"
            problem = f"it moves the link '{name}', which has no mass"
            yield Fault(where, problem, True, "made fixed at zero", partial(urdf.fix_joint, carrier, 0.0))


def thicken(robot: ElementTree.Element, group_of: str) -> Iterator[Fault]:
    """Mend the rods and point masses of the body that begins with the link `group_of`."""
    group = urdf.reached(group_of, _carried(robot)[0])
    for link in robot.findall("link"):
        mass, tensor = inertial_numbers(link)
        inertial = link.find("inertial")
        if link.get("name", "") not in group or inertial is None or not mass or tensor is None:
            continue
        principal = np.linalg.eigvalsh(tensor)
        if principal[0] > 1e-9 * principal[2]:
            continue
        better = solid_sphere(mass)
        if principal[2] > 0.0:
            better = urdf.nearest_inertia(tensor, urdf.ROUNDING * principal[2])
        problem = (
            f"its inertia is not positive definite: principal inertias {urdf.principal_text(tensor)} kg m^2"
        )
        remedy = f"principal inertias set to {urdf.principal_text(better)} kg m^2"
        mend = partial(urdf.set_inertia, inertial, better)
        yield Fault(f"link '{link.get('name', '')}'", problem, True, remedy, mend)


def solid_sphere(mass: float) -> FloatArray:
    """Inertia (3, 3) [kg m^2] of a solid aluminium sphere."""
    radius = float((3.0 * mass / (4.0 * math.pi * _ALUMINIUM)) ** (1.0 / 3.0))
    return 0.4 * mass * radius**2 * np.eye(3)


def _carried(robot: ElementTree.Element) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Links that each link carries by fixed joints, and by moving ones."""
    fixed: dict[str, list[str]] = {}
    moving: dict[str, list[str]] = {}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            side = moving if joint.get("type") in urdf.MOVING else fixed
            side.setdefault(parent.get("link", ""), []).append(child.get("link", ""))
    return fixed, moving
