"""Write a URDF and an SRDF without further files for each robot of the problem set.

Run: python -m benchmarks.problems.robots
The URDF has the moving bodies (with the links fixed to them), their inertias, the joints with their limits,
and boxes and cylinders in place of meshes. The SRDF names the pairs of links without a clearance: neighbours,
and pairs whose shapes are always near each other.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms

FOLDER = Path(__file__).resolve().parent / "robots"
NEAR = 0.02  # [m] pairs that are nearer in all of `POSTURES` random postures have no clearance
POSTURES = 300


class Robot(NamedTuple):
    """A packaged robot, the frames that have goals, the largest joint rate [rad/s], and a torque factor."""

    model: str
    frames: tuple[str, ...]
    rate: float
    torque: float = 1.0


# Industrial arms on a satellite of 200 kg have the low rates of arms in orbit, and 1 % of their torques,
# because they do not carry their weight.
ROBOTS = {
    "planar_3r": Robot("planar_3r", ("end_effector",), 0.4),
    "ur5": Robot("satellite_ur5", ("tool0",), 0.5, 0.01),
    "panda": Robot("satellite_panda", ("panda_hand_tcp",), 0.5, 0.01),
    "xarm7": Robot("satellite_xarm7", ("link_eef",), 0.5, 0.01),
    "space_arm_7": Robot("space_arm_7", ("end_effector",), 0.07),
    "two_arms": Robot("two_arms", ("left_tool", "right_tool"), 0.2),
}


def written(name: str) -> tuple[str, str]:
    """Return URDF and SRDF of a robot as text."""
    robot = ROBOTS[name]
    sms = ffsms.load(robot.model, end_effector=robot.frames[0])
    model, links = sms.model, ["base", *(f"{joint}_body" for joint in sms.joint_names)]
    root = ElementTree.Element("robot", {"name": name})
    for i, link in enumerate(links):
        element = ElementTree.SubElement(root, "link", {"name": link})
        _inertial(element, model.inertias[i + 1])
        for part in (part for part in sms.convex_parts() if part.body == i - 1):
            _shape(element, part)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for j, joint in enumerate(sms.joint_names):
        element = ElementTree.SubElement(root, "joint", {"name": joint, "type": "revolute"})
        _place(element, links[model.parents[j + 2] - 1], links[j + 1], model.jointPlacements[j + 2])
        # The axis in the joint's frame, from the Jacobian's column in inertial axes.
        axis = data.oMi[j + 2].rotation.T @ data.J[3:, 6 + j]
        ElementTree.SubElement(element, "axis", {"xyz": _words(axis)})
        bounds = {"lower": sms.limits.lower[j], "upper": sms.limits.upper[j]}
        bounds["effort"] = robot.torque * sms.limits.torque[j]
        bounds["velocity"] = min(sms.limits.velocity[j], robot.rate)
        ElementTree.SubElement(element, "limit", {key: _words([value]) for key, value in bounds.items()})
    for frame in robot.frames:
        at = model.frames[model.getFrameId(frame)]
        ElementTree.SubElement(root, "link", {"name": frame})
        element = ElementTree.SubElement(root, "joint", {"name": f"{frame}_mount", "type": "fixed"})
        _place(element, links[at.parentJoint - 1], frame, at.placement)
    ElementTree.indent(root)
    urdf = ElementTree.tostring(root, encoding="unicode") + "\n"
    return urdf, _left_out(name, urdf)


def _left_out(name: str, urdf: str) -> str:
    """Return the SRDF with the pairs that have no clearance."""
    model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    geometry = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.COLLISION)
    geometry.addAllCollisionPairs()
    data, placed, rng = model.createData(), geometry.createData(), np.random.default_rng(0)
    low, high = model.lowerPositionLimit[7:], model.upperPositionLimit[7:]
    furthest: dict[tuple[int, int], float] = {}
    for _ in range(POSTURES):
        q = np.concatenate([[0.0] * 6 + [1.0], rng.uniform(low, high)])
        pin.computeDistances(model, data, geometry, placed, q)
        now: dict[tuple[int, int], float] = {}
        for pair, found in zip(geometry.collisionPairs, placed.distanceResults, strict=True):
            a, b = sorted(int(geometry.geometryObjects[k].parentJoint) for k in (pair.first, pair.second))
            near = model.parents[b] == a
            now[a, b] = -1.0 if near else min(now.get((a, b), np.inf), found.min_distance)
        furthest = {key: max(value, furthest.get(key, -1.0)) for key, value in now.items()}
    links = ["base", *(f"{joint}_body" for joint in model.names[2:])]
    root = ElementTree.Element("robot", {"name": name})
    for (a, b), distance in furthest.items():
        if distance < NEAR:
            reason = "Adjacent" if model.parents[b] == a else "Default"
            pair = {"link1": links[a - 1], "link2": links[b - 1], "reason": reason}
            ElementTree.SubElement(root, "disable_collisions", pair)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _inertial(link: ElementTree.Element, inertia: pin.Inertia) -> None:
    element = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(element, "origin", {"xyz": _words(inertia.lever)})
    ElementTree.SubElement(element, "mass", {"value": _words([inertia.mass])})
    tensor = {
        f"i{'xyz'[i]}{'xyz'[j]}": _words([inertia.inertia[i, j]]) for i in range(3) for j in range(i, 3)
    }
    ElementTree.SubElement(element, "inertia", tensor)


def _shape(link: ElementTree.Element, part: ffsms.system.convex_parts.Part) -> None:
    """Add a collision shape to a link: a cylinder unchanged, any other shape as its bounding box."""
    element = ElementTree.SubElement(link, "collision")
    round_one = isinstance(part.shape, coal.Cylinder)
    place = pin.SE3(part.place.getRotation(), part.place.getTranslation())
    _origin(element, place if round_one else pin.SE3(part.axes, part.centre))
    geometry = ElementTree.SubElement(element, "geometry")
    if round_one:
        sizes = {"radius": _words([part.shape.radius]), "length": _words([2.0 * part.shape.halfLength])}
        ElementTree.SubElement(geometry, "cylinder", sizes)
    else:
        ElementTree.SubElement(geometry, "box", {"size": _words(2.0 * part.half)})


def _place(joint: ElementTree.Element, parent: str, child: str, place: pin.SE3) -> None:
    ElementTree.SubElement(joint, "parent", {"link": parent})
    ElementTree.SubElement(joint, "child", {"link": child})
    _origin(joint, place)


def _origin(element: ElementTree.Element, place: pin.SE3) -> None:
    turn = pin.rpy.matrixToRpy(place.rotation)
    ElementTree.SubElement(element, "origin", {"xyz": _words(place.translation), "rpy": _words(turn)})


def _words(values: object) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in np.round(np.asarray(values, dtype=float), 12))


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for robot in ROBOTS:
        for suffix, text in zip(("urdf", "srdf"), written(robot), strict=True):
            (FOLDER / f"{robot}.{suffix}").write_text(text)
        print(robot)
