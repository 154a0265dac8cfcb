"""The search for faults of a URDF's name, root, joints and shapes, and for unused elements."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from xml.etree import ElementTree

import numpy as np

from ffsms_pin.geometry.shapes import find_mesh, shape_problem
from ffsms_pin.inspection.faults import Fault, Settings, elements, faults_in
from ffsms_pin.system.urdf_elements import (
    MOVING,
    UNLIMITED,
    fix_joint,
    is_number,
    joint_of,
    label,
    origin_of,
    reached,
    spelt,
    tensor_of,
    triple_of,
)
from ffsms_pin.system.urdf_file import (
    chain_text,
    followed_joint,
    light_base,
    unused_declarations,
    virtual_base,
)


def name_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find a robot without a name, which urdfdom refuses."""
    if not robot.get("name"):
        name = settings.path.stem or "robot"
        remedy = f"named '{name}' after the file"
        yield Fault("robot", "it has no name", True, remedy, partial(robot.set, "name", name))


def root_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find floating joints, and a chain of massless links that makes the base float."""
    items = robot.findall("joint")
    tree = [joint_of(item) for item in items]
    children, parents = {joint.child for joint in tree}, [joint.parent for joint in tree]
    roots = [link for link in robot.findall("link") if link.get("name") not in children]
    for item, joint in zip(items, tree, strict=True):
        if joint.type != "floating":
            continue
        on_root = joint.child and [joint.parent] == [link.get("name", "") for link in roots]
        if on_root and roots[0].find("inertial") is None and parents.count(joint.parent) == 1:
            link = f"the {label(roots[0])}"
            problem = f"it lets the robot float in {link}, but the library adds the free-flyer itself"
            mend = partial(_remove, robot, [roots[0], item])
            yield Fault(label(item), problem, True, f"removed, with {link}", mend)
        else:
            yield Fault(label(item), "a floating joint inside the robot is not supported", True)
    if chain := virtual_base(robot):
        problem = (
            f"the joints {chain_text(chain)} let the base float, but the library adds the free-flyer itself"
        )
        mend = partial(_remove, robot, chain)
        yield Fault(label(chain[0]), problem, True, "removed, with their massless links", mend)


def declaration_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find unused declarations (`unused_declarations`), and a root link that is too light for a satellite."""
    for where, problem in unused_declarations(robot):
        yield Fault(where, problem, False)
    if reason := light_base(robot):
        yield Fault("file", f"{reason} ffsms_pin.mount", False)


def joint_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find joints with <mimic>, a zero or non-unit axis, missing or invalid limits, or empty <dynamics>."""
    for joint in robot.findall("joint"):
        where = label(joint)
        if joint.get("type") not in MOVING or any(faults_in(joint, where)):
            continue  # `number_faults` reports unreadable numbers
        mimic = joint.find("mimic")
        if mimic is not None:
            yield _mimic_fault(robot, joint, mimic, where)
            continue
        length = _axis_length(joint)
        if length < 1e-9:
            yield Fault(where, "its axis is zero", True)
            continue
        if abs(length - 1.0) > 1e-3:
            problem = f"its axis has length {length:.4g}; it is normalised to length 1"
            yield Fault(where, problem, False)
        yield from _limit_faults(robot, joint, where, settings)
        for dynamics in joint.findall("dynamics"):
            if dynamics.get("damping") is None and dynamics.get("friction") is None:
                problem = "a <dynamics> with neither damping nor friction"
                yield Fault(where, problem, True, "removed", partial(joint.remove, dynamics))


def _limit_faults(
    robot: ElementTree.Element, joint: ElementTree.Element, where: str, settings: Settings
) -> Iterator[Fault]:
    kind, limit = joint.get("type"), joint.find("limit")
    unit, force, reach = ("m", "N", 1.0) if kind == "prismatic" else ("rad", "N m", math.pi)
    usual = {"velocity": (settings.rate, f"{unit}/s"), "effort": (settings.effort, force)}
    between = {"lower": spelt(-reach), "upper": spelt(reach)}
    if limit is None and kind == "continuous":
        yield Fault(where, "it has no rate limit and no torque limit", False)
    elif limit is None:
        defaults = " and ".join(f"{key} {value:g} {measure}" for key, (value, measure) in usual.items())
        values = between | {key: spelt(value) for key, (value, _) in usual.items()}
        blocks = kind != "revolute"  # `load` gives a revolute joint default limits
        remedy = f"limited to +/-{reach:.4g} {unit}, {defaults}"
        added = partial(joint.append, ElementTree.Element("limit", values))
        yield Fault(where, f"it is {kind} but has no <limit>", blocks, remedy, added)
    else:
        wheel = kind != "prismatic" and _is_wheel(robot, joint)
        for key, (value, measure) in usual.items():
            text = limit.get(key)
            if text is None or float(text) <= 0.0:
                problem = f"it has no {key} limit" if text is None else f"its {key} limit is {text}"
                remedy = f"{key} limit set to {value:g} {measure}"
                mend = partial(limit.set, key, spelt(value))
                if wheel:
                    remedy = f"{key} limit removed, because the joint turns a wheel"
                    mend = partial(limit.set, key, UNLIMITED)
                yield Fault(where, problem, True, remedy, mend)
        low, high = limit.get("lower", "0"), limit.get("upper", "0")
        if kind == "continuous":
            return
        if not {"lower", "upper"} & set(limit.attrib):
            problem, remedy = "its <limit> has neither lower nor upper", f"limited to +/-{reach:.4g} {unit}"
            yield Fault(where, problem, True, remedy, partial(limit.attrib.update, between))
        elif float(low) > float(high):
            problem = f"its limits are in the wrong order: lower {low}, upper {high}"
            mend = partial(limit.attrib.update, {"lower": high, "upper": low})
            yield Fault(where, problem, True, "exchanged", mend)
        elif float(low) == float(high):
            problem = f"its limits are equal: lower and upper are both {low}"
            remedy, mend = f"made fixed at {low} {unit}", partial(fix_joint, joint, float(low))
            if wheel:
                remedy, mend = (
                    "made continuous, because the joint turns a wheel",
                    partial(_turn_freely, joint, limit),
                )
            yield Fault(where, problem, True, remedy, mend)


def _is_wheel(robot: ElementTree.Element, joint: ElementTree.Element) -> bool:
    """Return whether a joint's child is a reaction wheel.

    A wheel is a single link on the base, balanced and symmetric about the joint's axis.
    """
    tree = [joint_of(item) for item in robot.findall("joint")]
    own = joint_of(joint)
    roots = {link.get("name", "") for link in robot.findall("link")} - {other.child for other in tree}
    base = {name for root in roots for name in reached(root, (other for other in tree if not other.moves))}
    body = reached(own.child, tree)
    links = [link for link in robot.findall("link") if link.get("name") in body]
    if own.parent not in base or len(links) != 1 or any(faults_in(links[0], "")):
        return False
    inertial = links[0].find("inertial")
    tensor = None if inertial is None else tensor_of(inertial)
    if inertial is None or tensor is None:
        return False
    place, axis = origin_of(inertial, math.inf), triple_of(joint.find("axis"), "xyz", "1 0 0", math.inf)
    axis = place.rotation.T @ axis / np.linalg.norm(axis)
    spin = float(axis @ tensor @ axis)
    cross = (float(np.trace(tensor)) - spin) / 2.0
    symmetric = cross * np.eye(3) + (spin - cross) * np.outer(axis, axis)
    off = np.linalg.norm(np.cross(axis, place.rotation.T @ place.translation))
    return bool(np.abs(tensor - symmetric).max() <= 1e-3 * np.abs(tensor).max() and off < 1e-3)


def _turn_freely(joint: ElementTree.Element, limit: ElementTree.Element) -> None:
    joint.set("type", "continuous")
    for key in ("lower", "upper"):
        limit.attrib.pop(key, None)


def _mimic_fault(
    robot: ElementTree.Element, joint: ElementTree.Element, mimic: ElementTree.Element, where: str
) -> Fault:
    joints = {other.get("name", ""): other for other in robot.findall("joint")}
    moving = {name: other for name, other in joints.items() if other.get("type") in MOVING}
    name = joint.get("name", "")
    leader = followed_joint(moving, name)[0]  # `load` locks a joint that follows another joint
    blocks = leader == name or leader not in joints
    problem = f"it mimics '{mimic.get('joint', '')}', which is not supported"
    if _axis_length(joint) <= 1e-9:
        return Fault(where, problem, True)
    offset = mimic.get("offset", "0")
    mend = partial(fix_joint, joint, float(offset))
    return Fault(where, problem, blocks, f"made fixed at its offset, {offset}", mend)


def shape_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Find shapes that cannot be loaded, and missing meshes."""
    for where, item in elements(robot):
        for kind in ("visual", "collision"):
            for shape in item.findall(kind):
                box, mesh = shape.find("geometry/box"), shape.find("geometry/mesh")
                size = [] if box is None else box.get("size", "0 0 0").split()
                if len(size) == 3 and all(map(is_number, size)) and min(map(float, size)) <= 0.0:
                    problem = f"a {kind} box has the size {' '.join(size)}; edges must be above zero"
                    yield Fault(where, problem, True, f"{kind} shape removed", partial(item.remove, shape))
                elif not any(faults_in(shape, where)) and (useless := shape_problem(shape)) is not None:
                    problem = f"a {kind} shape {useless}; without it the robot has no {kind} model"
                    yield Fault(where, problem, False)
                elif mesh is not None:
                    name = mesh.get("filename", "")
                    if find_mesh(name, settings.path) is None:
                        yield Fault(where, f"the {kind} mesh '{name}' does not exist", False)


def _remove(robot: ElementTree.Element, items: list[ElementTree.Element]) -> None:
    for item in items:
        robot.remove(item)


def _axis_length(joint: ElementTree.Element) -> float:
    """Return the length of a joint's axis vector."""
    axis = joint.find("axis")
    return 1.0 if axis is None else math.hypot(*map(float, axis.get("xyz", "0 0 0").split()))
