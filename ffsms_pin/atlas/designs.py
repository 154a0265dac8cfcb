"""Changed designs of a robot: base mass, base inertia, mount point, link lengths. Plain functions.

Each returns another SpaceManipulator; the one that is given stays as it is. Where the shapes of the file no
longer fit (another mount point, another link length), the result has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance, positive, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

# Bodies whose joints are nearer together than this have no length to stretch [m].
_NO_LENGTH = 1e-6


@dataclass(frozen=True)
class Design:
    """Changes to a robot, all at once; the defaults change nothing.

    Attributes
    ----------
    base_mass : float
        Factor of the base's mass, its inertia in proportion.
    base_inertia : float
        Factor of the base's inertia about its centre of mass, besides.
    mount : tuple of float
        By how far the arm's mount point moves, base axes [m].
    links : mapping of str to float
        Factors of the length of the links that joints carry, by the joints' names.
    """

    base_mass: float = 1.0
    base_inertia: float = 1.0
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    links: Mapping[str, float] = field(default_factory=dict)

    def applied(self, sms: SpaceManipulator) -> SpaceManipulator:
        """The robot with these changes.

        Raises
        ------
        InvalidValue
            A factor is not above zero, or a joint carries no link of any length.
        """
        instance("sms", sms, SpaceManipulator)
        if self.base_mass != 1.0:
            sms = with_base_mass(sms, sms.model.inertias[1].mass * positive("base_mass", self.base_mass))
        if self.base_inertia != 1.0:
            sms = with_base_inertia(sms, self.base_inertia)
        if any(self.mount):
            sms = with_mount_moved(sms, self.mount)
        for joint, factor in self.links.items():
            sms = with_link_length(sms, joint, factor)
        return sms


def with_base_mass(sms: SpaceManipulator, mass: float) -> SpaceManipulator:
    """The robot with a base of another mass [kg], its inertia in proportion, its centre of mass as it is."""
    base = sms.model.inertias[1]
    share = positive("mass", mass, "kg") / base.mass
    return _with_base(sms, pin.Inertia(mass, base.lever, share * base.inertia))


def with_base_inertia(sms: SpaceManipulator, factor: float) -> SpaceManipulator:
    """The robot with a base of `factor` times the inertia about its centre of mass; the mass stays."""
    base = sms.model.inertias[1]
    return _with_base(sms, pin.Inertia(base.mass, base.lever, positive("factor", factor) * base.inertia))


def _with_base(sms: SpaceManipulator, base: pin.Inertia) -> SpaceManipulator:
    return sms.with_inertias([base, *list(sms.model.inertias)[2:]])


def with_mount_moved(sms: SpaceManipulator, shift: ArrayLike) -> SpaceManipulator:
    """The robot with all that the base carries moved by `shift` (3,), base axes [m].

    What is fixed to the base stays there: of an arm's own root link, mass and place.
    """
    by = vector("shift", shift, 3, "m")
    model = sms.model.copy()
    _move(model, 1, [sms.frame_id], np.eye(3), by)
    return _remade(sms, model)


def with_link_length(sms: SpaceManipulator, joint: str, factor: float) -> SpaceManipulator:
    """The robot with the link that a joint carries stretched along its length.

    The length runs from the joint to the next one, or to the end effector. Material is added as the link
    grows: its cross section and its mass per length stay. Axes of joints keep their directions.

    Raises
    ------
    InvalidValue
        There is no such joint, the factor is not above zero, or the next joint has the same origin.
    """
    if joint not in sms.joint_names:
        raise InvalidValue("joint", joint, f"must be one of {', '.join(sms.joint_names)}")
    by = positive("factor", factor)
    model = sms.model.copy()
    index = int(model.getJointId(joint))
    along = _length(sms, index)
    size = float(np.linalg.norm(along))
    if size < _NO_LENGTH:
        problem = "must carry a link that has a length; the next joint is at its origin"
        raise InvalidValue("joint", joint, problem)
    unit = along / size
    stretch = np.eye(3) + (by - 1.0) * np.outer(unit, unit)
    model.inertias[index] = stretched(model.inertias[index], stretch, by)
    frames = [k for k, frame in enumerate(model.frames) if frame.type != pin.FrameType.JOINT]
    _move(model, index, frames, stretch, np.zeros(3))
    return _remade(sms, model)


def stretched(body: pin.Inertia, stretch: FloatArray, mass: float) -> pin.Inertia:
    """Inertia of a body whose points move by a matrix, its mass times a factor.

    By the second moments of mass, S = tr(I) / 2 - I, which turn into factor times stretch S stretch^T.
    """
    second = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
    moved = mass * stretch @ second @ stretch.T
    return pin.Inertia(mass * body.mass, stretch @ body.lever, np.trace(moved) * np.eye(3) - moved)


def _length(sms: SpaceManipulator, joint: int) -> FloatArray:
    """From a joint to the next one on the way to the end effector, else to any next one (3,) [m]."""
    model, frame = sms.model, sms.model.frames[sms.frame_id]
    if int(frame.parentJoint) == joint:
        return np.array(frame.placement.translation)
    nexts = [j for j in range(joint + 1, model.njoints) if int(model.parents[j]) == joint]
    to_tip = set(model.supports[int(frame.parentJoint)])
    nexts.sort(key=lambda j: j not in to_tip)
    return np.array(model.jointPlacements[nexts[0]].translation) if nexts else np.zeros(3)


def _move(model: pin.Model, parent: int, frames: list[int], turn: FloatArray, shift: FloatArray) -> None:
    """Take the joints that a joint carries, and of these frames its own, to where their origins go."""

    def moved(place: pin.SE3) -> pin.SE3:
        return pin.SE3(place.rotation, turn @ place.translation + shift)

    for j in range(2, model.njoints):
        if int(model.parents[j]) == parent:
            model.jointPlacements[j] = moved(model.jointPlacements[j])
    for k in frames:
        if int(model.frames[k].parentJoint) == parent:
            model.frames[k].placement = moved(model.frames[k].placement)


def _remade(sms: SpaceManipulator, model: pin.Model) -> SpaceManipulator:
    box = (sms.base_size, sms.base_box_placement)
    made = SpaceManipulator(model, sms.end_effector, *box, limits=sms.limits)
    return made.with_actuators(sms.wheels, sms.thrusters)
