"""Faults of joints and of the robot as a whole: names, types, limits, shapes that cannot be."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from xml.etree import ElementTree

from ffsms_pin.inspection.faults import Fault, Settings
from ffsms_pin.inspection.numbers import elements, faults_in
from ffsms_pin.system.shapes import find_mesh, shape_problem
from ffsms_pin.system.urdf_edit import fix_joint, words
from ffsms_pin.system.urdf_elements import is_number

__all__ = ["joint_faults", "name_faults", "root_faults", "shape_faults"]

_MOVING = ("revolute", "continuous", "prismatic")


def name_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """A robot without a name, which urdfdom refuses."""
    if not robot.get("name"):
        name = settings.path.stem or "robot"
        yield Fault(
            "robot",
            "it has no name",
            True,
            f"named '{name}' after the file",
            partial(robot.set, "name", name),
        )


def root_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """A world link that carries the satellite by a floating joint: the library adds that joint itself."""
    children = {child.get("link") for child in robot.iterfind("joint/child")}
    roots = [link for link in robot.findall("link") if link.get("name") not in children]
    for joint in robot.findall("joint"):
        if joint.get("type") != "floating":
            continue
        where = f"joint '{joint.get('name', '')}'"
        parent, child = joint.find("parent"), joint.find("child")
        on_root = (
            len(roots) == 1
            and parent is not None
            and child is not None
            and parent.get("link") == roots[0].get("name")
            and roots[0].find("inertial") is None
            and sum(p.get("link") == parent.get("link") for p in robot.iterfind("joint/parent")) == 1
        )
        if on_root:
            name = roots[0].get("name", "")
            yield Fault(
                where,
                f"it lets the robot float in the link '{name}', but the library adds the free-flyer itself",
                True,
                f"taken out, with the link '{name}'",
                partial(_remove, robot, [roots[0], joint]),
            )
        else:
            yield Fault(where, "a floating joint inside the robot cannot be used", True)


def joint_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Joints that mimic, joints without usable limits, empty <dynamics>."""
    for joint in robot.findall("joint"):
        where = f"joint '{joint.get('name', '')}'"
        if joint.get("type") not in _MOVING or any(faults_in(joint, where)):
            continue  # a number that could not be mended is a fault already
        mimic = joint.find("mimic")
        if mimic is not None:
            yield _mimic_fault(robot, joint, mimic, where)
            continue
        axis = joint.find("axis")
        if axis is not None and (length := _length(axis.get("xyz", "0 0 0"))) is not None:
            if length < 1e-9:
                yield Fault(where, "its axis is zero", True)
                continue
            if abs(length - 1.0) > 1e-3:
                yield Fault(
                    where, f"its axis has length {length:.4g}, and is read as if it had length 1", False
                )
        yield from _limit_faults(joint, where, settings)
        for dynamics in joint.findall("dynamics"):
            if dynamics.get("damping") is None and dynamics.get("friction") is None:
                yield Fault(
                    where,
                    "a <dynamics> with neither damping nor friction",
                    True,
                    "taken out",
                    partial(joint.remove, dynamics),
                )


def _limit_faults(joint: ElementTree.Element, where: str, settings: Settings) -> Iterator[Fault]:
    kind, limit = joint.get("type"), joint.find("limit")
    limited, unit = kind != "continuous", "m" if kind == "prismatic" else "rad"
    usual = {
        "velocity": (settings.rate, f"{unit}/s"),
        "effort": (settings.effort, "N" if kind == "prismatic" else "N m"),
    }
    if limit is None:
        if not limited:
            yield Fault(where, "it has no rate limit and no torque limit", False)
            return
        reach = 1.0 if kind == "prismatic" else math.pi
        values = {"lower": -reach, "upper": reach} | {key: value for key, (value, _) in usual.items()}
        yield Fault(
            where,
            f"it is {kind} but has no <limit>",
            kind != "revolute",  # which `load` limits like this too
            f"limited to +/-{reach:.4g} {unit}, "
            + " and ".join(f"{key} {value:g} {measure}" for key, (value, measure) in usual.items()),
            partial(_add_limit, joint, values),
        )
        return
    for key, (value, measure) in usual.items():
        text = limit.get(key)
        if text is None or float(text) <= 0.0:
            problem = f"it has no {key} limit" if text is None else f"its {key} limit is {text}"
            remedy = f"{key} limit set to {value:g} {measure}"
            yield Fault(where, problem, True, remedy, partial(limit.set, key, words(value)))
    if limited:
        yield from _range_faults(joint, limit, where, unit)


def _range_faults(
    joint: ElementTree.Element, limit: ElementTree.Element, where: str, unit: str
) -> Iterator[Fault]:
    given = "lower" in limit.attrib or "upper" in limit.attrib
    low, high = limit.get("lower", "0"), limit.get("upper", "0")
    if not given:
        reach = 1.0 if unit == "m" else math.pi
        yield Fault(
            where,
            "its <limit> has neither lower nor upper",
            True,
            f"limited to +/-{reach:.4g} {unit}",
            partial(limit.attrib.update, {"lower": words(-reach), "upper": words(reach)}),
        )
    elif float(low) > float(high):
        yield Fault(
            where,
            f"its limits are the wrong way round: lower {low}, upper {high}",
            True,
            "exchanged",
            partial(limit.attrib.update, {"lower": high, "upper": low}),
        )
    elif float(low) == float(high):
        yield Fault(
            where,
            f"its limits leave no room: lower and upper are both {low}",
            True,
            f"made fixed at {low} {unit}",
            partial(fix_joint, joint, float(low)),
        )


def _mimic_fault(
    robot: ElementTree.Element, joint: ElementTree.Element, mimic: ElementTree.Element, where: str
) -> Fault:
    leaders = [other.get("name", "") for other in robot.findall("joint") if other is not joint]
    blocks = mimic.get("joint", "") not in leaders  # else `load` locks it too
    problem = f"it mimics '{mimic.get('joint', '')}', and cannot follow it"
    offset = mimic.get("offset", "0")
    axis = joint.find("axis")
    usable = axis is None or (_length(axis.get("xyz", "0 0 0")) or 0.0) > 1e-9
    if not usable:
        return Fault(where, problem, True)
    return Fault(
        where,
        problem,
        blocks,
        f"made fixed at its offset, {offset}",
        partial(fix_joint, joint, float(offset)),
    )


def shape_faults(robot: ElementTree.Element, settings: Settings) -> Iterator[Fault]:
    """Shapes that cannot be built, and meshes that are not there."""
    for where, item in elements(robot):
        for kind in ("visual", "collision"):
            for shape in item.findall(kind):
                box, mesh = shape.find("geometry/box"), shape.find("geometry/mesh")
                size = [] if box is None else box.get("size", "0 0 0").split()
                if len(size) == 3 and all(map(is_number, size)) and min(map(float, size)) <= 0.0:
                    problem = f"a {kind} box of size {' '.join(size)}"
                    yield Fault(where, problem, True, f"{kind} shape taken out", partial(item.remove, shape))
                elif not any(faults_in(shape, where)) and (useless := shape_problem(shape)) is not None:
                    yield Fault(where, f"a {kind} shape {useless}: the robot has no {kind} model", False)
                elif mesh is not None:
                    name = mesh.get("filename", "")
                    if find_mesh(name, settings.path) is None:
                        yield Fault(where, f"the {kind} mesh '{name}' is not found", False)


def _add_limit(joint: ElementTree.Element, values: dict[str, float]) -> None:
    ElementTree.SubElement(joint, "limit", {key: words(value) for key, value in values.items()})


def _remove(robot: ElementTree.Element, items: list[ElementTree.Element]) -> None:
    for item in items:
        robot.remove(item)


def _length(text: str) -> float | None:
    numbers = text.split()
    return math.hypot(*map(float, numbers)) if len(numbers) == 3 and all(map(is_number, numbers)) else None
