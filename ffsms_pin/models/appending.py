"""Robots that are given as Pinocchio models, and arms from MJCF files, on a satellite."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import number
from ffsms_pin.errors import FfsmsWarning, InvalidUrdf, InvalidValue, UnsupportedJoint
from ffsms_pin.files import check_readable, read_content
from ffsms_pin.models.base import KINDS, SatelliteBase, satellite_model
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.joints import JointLayout
from ffsms_pin.system.loading import Asked, set_limits
from ffsms_pin.system.shapes import GivenShapes, given_shapes
from ffsms_pin.system.urdf_leniency import DEFAULT_RATE

ShapePair = tuple[Any, Any] | None  # visual and collision shapes, pinocchio.GeometryModel


def is_mjcf(path: Path) -> bool:
    """Whether the file is MJCF by its name or its root element; a URDF may be called .xml too."""
    if path.suffix.lower() == ".mjcf":
        return True
    try:
        return path.suffix.lower() == ".xml" and ElementTree.fromstring(read_content(path)).tag == "mujoco"
    except (OSError, ElementTree.ParseError, ValueError, LookupError):
        return False  # the reader of URDFs says what is wrong


def read_mjcf(path: Path) -> tuple[Any, ShapePair]:
    """The pinocchio.Model of an MJCF file, and its visual and collision shapes."""
    try:
        check_readable(path)
        model = pin.buildModelFromMJCF(str(path))
    except Exception as error:  # whatever Pinocchio's reader objects to
        raise InvalidUrdf(path, f"Pinocchio cannot read it as MJCF ({error})") from None
    try:
        shapes = (pin.buildGeomFromMJCF(model, str(path), kind) for kind in KINDS)
        return model, given_shapes(model, *shapes)
    except Exception as error:  # of the readers of meshes: each has its own kinds
        text = f"{path}: its shapes cannot be read, and the robot has none ({error})"
        warnings.warn(text, FfsmsWarning, stacklevel=4)
        return model, None


def append(
    arm: Any, shapes: ShapePair, base: SatelliteBase, placement: Any, asked: Asked
) -> SpaceManipulator:
    """A satellite with the arm `arm` (pinocchio.Model) at `placement`.

    What the model fixes to its universe is fixed to the satellite. `shapes` are the visual and the collision
    shapes of the arm; those of the satellite are added to both.
    """
    _check_freedoms(arm)
    arm, shapes = _lock(arm, shapes, asked.locked or {})
    satellite, own = satellite_model(base)
    frame = satellite.getFrameId("satellite")
    model = pin.appendModel(satellite, arm, frame, placement)
    description = None
    if shapes is not None:
        pairs = zip(own, shapes, strict=True)
        whole = [pin.appendModel(satellite, arm, *pair, frame, placement)[1] for pair in pairs]
        description = GivenShapes(*whole)
    model.name = f"satellite_{arm.name or 'arm'}"
    box = (base.size, pin.SE3.Identity()) if asked.base_size is None else (asked.base_size, None)
    return _made(model, asked, box, description)


def whole(model: Any, asked: Asked, shapes: ShapePair) -> SpaceManipulator:
    """The robot of a pinocchio.Model with a free-flyer root."""
    JointLayout(model)  # a free-flyer first, and joints of one degree of freedom
    model, shapes = _lock(model, shapes, asked.locked or {})
    description = None if shapes is None else GivenShapes(*shapes)
    return _made(model.copy(), asked, (asked.base_size, None), description)


def _made(model: Any, asked: Asked, box: tuple[Any, Any], shapes: GivenShapes | None) -> SpaceManipulator:
    set_limits(model, asked, DEFAULT_RATE)
    return SpaceManipulator(model, asked.end_effector, *box, asked.acceleration, description=shapes)


def _check_freedoms(arm: Any) -> None:
    """Raise `UnsupportedJoint` unless each joint has one degree of freedom, and there is one."""
    name = arm.name or "the arm"
    if arm.njoints < 2:
        raise UnsupportedJoint(name, "the model has no joint; an arm needs at least one")
    for j in range(1, arm.njoints):
        joint, freedoms = f"joint '{arm.names[j]}'", arm.joints[j].nv
        if freedoms == 6 and arm.parents[j] == 0:
            problem = f"{joint} is a free-flyer, which the satellite has: give the arm without"
            raise UnsupportedJoint(name, problem)
        if freedoms != 1:
            raise UnsupportedJoint(name, f"{joint} has {freedoms} degrees of freedom; one is supported")


def _lock(arm: Any, shapes: ShapePair, locked: Mapping[str, float]) -> tuple[Any, ShapePair]:
    names = [arm.names[j] for j in range(1, arm.njoints) if arm.joints[j].nv == 1]  # not the free-flyer
    q = pin.neutral(arm)
    fixed = []
    for name, position in locked.items():
        if name not in names:
            raise InvalidValue("locked", name, f"names no moving joint of the arm ({', '.join(names)})")
        place = number(f"locked['{name}']", position)
        j = arm.getJointId(name)
        k = arm.joints[j].idx_q
        if arm.joints[j].nq == 2:  # a continuous joint: cosine and sine
            q[k : k + 2] = np.cos(place), np.sin(place)
        else:
            q[k] = place
        fixed.append(j)
    if len(fixed) == len(names):
        raise UnsupportedJoint(arm.name or "the arm", "every joint is locked; an arm needs one that moves")
    if not fixed:
        return arm, shapes
    if shapes is None:
        return pin.buildReducedModel(arm, fixed, q), None
    reduced, (visual, collision) = pin.buildReducedModel(arm, list(shapes), fixed, q)
    return reduced, (visual, collision)
