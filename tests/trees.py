"""Define robots by masses, lengths and axes, so that tests can compute them without Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.urdf import model_path

__all__ = ["Body", "Tree", "packaged_planar", "random_robot"]

Array = NDArray[np.float64]


class Body(NamedTuple):
    """A rigid body and the joint that carries it; the first body is the base and has no joint."""

    parent: int
    kind: str  # "base", "revolute", "continuous" or "prismatic"
    rotation: Array  # rotation of the joint frame in the parent's frame
    position: Array
    axis: Array  # joint axis in the joint frame
    mass: float
    com: Array  # centre of mass in the body's frame
    inertia: Array  # about the centre of mass, body axes


@dataclass(frozen=True)
class Tree:
    """A robot given by masses, lengths and axes, so that tests can compute it without Pinocchio."""

    bodies: list[Body]
    tip_rotation: Array  # end effector in the last body's frame
    tip_position: Array

    @property
    def n(self) -> int:
        """The number of joints."""
        return len(self.bodies) - 1

    def model(self) -> Any:
        """Return the robot as a pinocchio.Model with the end effector "tip"."""
        model = pin.Model()
        model.name = "tree"
        for i, body in enumerate(self.bodies):
            if body.kind == "base":
                joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
            else:
                place = pin.SE3(body.rotation, body.position)
                joint = model.addJoint(body.parent + 1, _joint_model(body), place, f"joint_{i}")
            model.appendBodyToJoint(joint, pin.Inertia(body.mass, body.com, body.inertia), pin.SE3.Identity())
        tip = pin.SE3(self.tip_rotation, self.tip_position)
        model.addFrame(pin.Frame("tip", len(self.bodies), 0, tip, pin.FrameType.OP_FRAME))
        return model

    def urdf(self, extra: str = "") -> str:
        """Return the robot as a URDF with links "link_0" (the base), "link_1", ... and end effector "tip"."""

        def pose(rotation: Array, position: Array) -> str:
            rpy = pin.rpy.matrixToRpy(rotation)
            return f'<origin xyz="{formatted(position)}" rpy="{formatted(rpy)}"/>'

        text = ['<robot name="tree">']
        for i, body in enumerate(self.bodies):
            inertia = " ".join(
                f'{name}="{float(body.inertia[j, k])!r}"'
                for name, j, k in zip(
                    ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), *np.triu_indices(3), strict=True
                )
            )
            text.append(
                f'<link name="link_{i}"><inertial>{pose(np.eye(3), body.com)}<mass value="{body.mass!r}"/>'
                f"<inertia {inertia}/></inertial></link>"
            )
            if i > 0:
                text.append(
                    f'<joint name="joint_{i}" type="{body.kind}"><parent link="link_{body.parent}"/>'
                    f'<child link="link_{i}"/>{pose(body.rotation, body.position)}'
                    f'<axis xyz="{formatted(body.axis)}"/>'
                    '<limit lower="-2.5" upper="2.0" velocity="0.4" effort="3.0"/></joint>'
                )
        text.append(
            f'<link name="tip"/><joint name="tip" type="fixed"><parent link="link_{self.n}"/>'
            f'<child link="tip"/>'
            f"{pose(self.tip_rotation, self.tip_position)}</joint>{extra}</robot>"
        )
        return "\n".join(text)


def formatted(numbers: Array) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def _joint_model(body: Body) -> Any:
    if body.kind == "revolute":
        return pin.JointModelRevoluteUnaligned(*body.axis)
    if body.kind == "prismatic":
        return pin.JointModelPrismaticUnaligned(*body.axis)
    # Pinocchio's Python bindings have no continuous joint about an arbitrary axis.
    return (pin.JointModelRUBX, pin.JointModelRUBY, pin.JointModelRUBZ)[int(np.argmax(body.axis))]()


def _direction(rng: np.random.Generator) -> Array:
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def _rotation(rng: np.random.Generator) -> Array:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q if np.linalg.det(q) > 0.0 else -q)


def _inertia(rng: np.random.Generator, mass: float) -> Array:
    """Return the inertia of a random solid box of a given mass, in random axes."""
    a, b, c = rng.uniform(0.05, 0.6, size=3) ** 2
    turn = _rotation(rng)
    return np.asarray(turn @ np.diag([b + c, a + c, a + b]) @ turn.T * mass / 12.0)


def random_robot(seed: int, n: int, kinds: tuple[str, ...] = ("revolute", "prismatic")) -> Tree:
    """Return the random branched robot of a seed."""
    rng = np.random.default_rng(seed)
    mass = float(rng.uniform(5.0, 300.0))
    com = rng.uniform(-0.4, 0.4, size=3)  # away from the root's origin
    inertia = _inertia(rng, mass) * 4.0
    bodies = [Body(-1, "base", np.eye(3), np.zeros(3), np.zeros(3), mass, com, inertia)]
    for i in range(1, n + 1):
        # Joints are in depth-first order, as Pinocchio requires.
        parent = i - 1
        while parent > 0 and rng.random() < 0.25:
            parent = bodies[parent].parent
        kind = str(rng.choice(kinds))
        aligned = kind == "continuous" or rng.random() < 0.5
        axis = np.eye(3)[rng.integers(0, 3)] if aligned else _direction(rng)
        mass = float(rng.uniform(0.3, 12.0))
        place = _rotation(rng), rng.uniform(-0.6, 0.6, size=3)
        com = rng.uniform(-0.3, 0.3, size=3)
        bodies.append(Body(parent, kind, *place, axis, mass, com, _inertia(rng, mass)))
    return Tree(bodies, _rotation(rng), rng.uniform(-0.5, 0.5, size=3))


def packaged_planar() -> Tree:
    """Return the packaged planar robot, read from its file."""

    def numbers(text: str) -> Array:
        return np.array([float(word) for word in text.split()])

    robot = ElementTree.parse(model_path("planar_3r")).getroot()
    links = {link.attrib["name"]: link for link in robot.findall("link")}
    names = ["base"]
    bodies: list[Body] = []
    joints = {joint.attrib["name"]: joint for joint in robot.findall("joint")}
    for joint in (None, joints["joint_1"], joints["joint_2"], joints["joint_3"]):
        parent, kind, position, axis = -1, "base", np.zeros(3), np.zeros(3)
        if joint is not None:
            child, origin, direction = joint.find("child"), joint.find("origin"), joint.find("axis")
            assert child is not None
            assert origin is not None
            assert direction is not None
            names.append(child.attrib["link"])
            parent, kind = len(bodies) - 1, "revolute"
            position, axis = numbers(origin.attrib["xyz"]), numbers(direction.attrib["xyz"])
        inertial = links[names[-1]].find("inertial")
        assert inertial is not None
        place, mass, inertia = inertial.find("origin"), inertial.find("mass"), inertial.find("inertia")
        assert place is not None
        assert mass is not None
        assert inertia is not None
        diagonal = np.diag([float(inertia.attrib[key]) for key in ("ixx", "iyy", "izz")])
        com, kilograms = numbers(place.attrib["xyz"]), float(mass.attrib["value"])
        bodies.append(Body(parent, kind, np.eye(3), position, axis, kilograms, com, diagonal))
    end = joints["tip"].find("origin")
    assert end is not None
    tip = numbers(end.attrib["xyz"])
    return Tree(bodies, np.eye(3), tip)
