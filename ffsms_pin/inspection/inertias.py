"""The search for faults of masses and inertias in a URDF."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from xml.etree import ElementTree

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.inspection.faults import Fault, Settings
from ffsms_pin.system import urdf_elements as urdf

_ALUMINIUM = 2700.0  # [kg/m^3] density


def inertial_numbers(link: ElementTree.Element) -> tuple[float | None, FloatArray | None]:
    """Return the mass [kg] and inertia (3, 3) [kg m^2] of a link, each None if missing or not numeric."""
    mass, inertial = link.find("inertial/mass"), link.find("inertial")
    kilograms = None
    if mass is not None and urdf.is_number(mass.get("value", "")):
        kilograms = float(mass.get("value", ""))
    return kilograms, None if inertial is None else urdf.tensor_of(inertial)


def inertia_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find negative masses, inertias that no rigid body has, and incomplete <inertial> elements."""
    for link in robot.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        where, element = urdf.label(link), inertial.find("inertia")
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
                yield Fault(where, problem, True, "<inertial> removed", mend)
        elif missing := [key for key in urdf.INERTIA_KEYS if key not in element.attrib]:
            problem = f"its <inertia> has no {', '.join(missing)}"
            if all(key[1] != key[2] for key in missing):  # only products of inertia are missing
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
    problem = _not_definite(tensor)
    if kind == "triangle":
        a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
        problem = f"its inertia breaks the triangle inequality: {a:.6g} + {b:.6g} < {c:.6g} kg m^2"
    nearest = urdf.nearest_inertia(tensor, 0.0)
    remedy = f"nearest inertia of a rigid body: principal {urdf.principal_text(nearest)} kg m^2"
    yield Fault(where, problem, True, remedy, partial(urdf.set_inertia, inertial, nearest))


def mass_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find a base without mass, and moving bodies without mass; links fixed to each other are one body."""
    joints = robot.findall("joint")
    tree = [urdf.joint_of(joint) for joint in joints]
    carrier_of = {joint.child: (joint, item) for joint, item in zip(tree, joints, strict=True)}
    whole = all(joint.find(end) is not None for joint in joints for end in ("parent", "child"))
    if not whole or len(carrier_of) < len(joints):
        return  # the links are not a tree; `refusal` reports this fault
    weights = {link.get("name", ""): inertial_numbers(link)[0] for link in robot.findall("link")}
    for name in weights:
        carrier, item = carrier_of.get(name, (None, None))
        if carrier is not None and not carrier.moves:
            continue
        group = urdf.reached(name, (joint for joint in tree if not joint.moves))
        if any(weights.get(link) for link in group):
            continue
        if carrier is None or item is None:
            problem = "the base has no mass, which a satellite must have: ffsms_pin.mount adds a satellite"
            yield Fault(f"link '{name}'", problem, True)
        elif any(joint.moves and joint.parent in group for joint in tree):
            yield Fault(f"link '{name}'", "it moves, and carries further joints, but has no mass", True)
        else:
            problem = f"it moves the link '{name}', which has no mass"
            mend = partial(urdf.fix_joint, item, 0.0)
            yield Fault(urdf.label(item), problem, True, "made fixed at zero", mend)


def thicken(robot: ElementTree.Element, group_of: str) -> Iterator[Fault]:
    """Find thin rods and point masses among the link `group_of` and the links that are fixed to it."""
    tree = map(urdf.joint_of, robot.findall("joint"))
    group = urdf.reached(group_of, (joint for joint in tree if not joint.moves))
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
        remedy = f"principal inertias set to {urdf.principal_text(better)} kg m^2"
        mend = partial(urdf.set_inertia, inertial, better)
        yield Fault(urdf.label(link), _not_definite(tensor), True, remedy, mend)


def _not_definite(tensor: FloatArray) -> str:
    principal = urdf.principal_text(tensor)
    return f"its inertia is not positive definite: principal inertias {principal} kg m^2"


def solid_sphere(mass: float) -> FloatArray:
    """Return the inertia (3, 3) [kg m^2] of a solid aluminium sphere with a mass [kg]."""
    radius = float((3.0 * mass / (4.0 * math.pi * _ALUMINIUM)) ** (1.0 / 3.0))
    return 0.4 * mass * radius**2 * np.eye(3)
