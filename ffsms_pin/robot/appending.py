"""The construction of robots from Pinocchio models of whole robots or of arms for a satellite."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import number
from ffsms_pin.errors import FfsmsWarning, InvalidValue, UnsupportedJoint
from ffsms_pin.geometry.shapes import GivenShapes, ShapeKind
from ffsms_pin.robot.base import SatelliteBase, satellite_model
from ffsms_pin.robot.building import LoadOptions, set_limits
from ffsms_pin.robot.manipulator import SpaceManipulator
from ffsms_pin.system.inertias import settle, settled
from ffsms_pin.system.mechanism import JointLayout
from ffsms_pin.system.urdf_elements import unused
from ffsms_pin.system.urdf_file import DEFAULT_RATE

ShapePair = tuple[Any, Any] | None  # visual and collision shapes, pinocchio.GeometryModel

# Attributes of a pinocchio.Model with one entry per entry of v: limits, friction and rotor inertia of joints.
_PER_VELOCITY = (
    "armature",
    "damping",
    "rotorInertia",
    "rotorGearRatio",
    *(f"{end}{kind}Limit" for end in ("lower", "upper") for kind in ("Effort", "Velocity", "DryFriction")),
)
_SATELLITE_FRAMES = 3  # universe, root_joint and satellite, the first frames of each robot on a satellite
# Attributes of a pinocchio.Model with one entry per entry of q.
_PER_POSITION = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")


def settled_model(model: Any, options: LoadOptions, stacklevel: int) -> Any:
    """Copy a model and check, keep or repair its inertias according to `options.inertias`.

    `stacklevel` is the argument of `warnings.warn`: 2 names the line that calls this function.
    """
    changes, made = dict[str, str](), model.copy()
    for j in range(1, model.njoints):
        body = model.inertias[j]
        tensor = np.array(body.inertia)
        if not np.isfinite(tensor).all() or not tensor.any():
            continue  # the robot's constructor checks zero inertias and those that are not finite
        name = JointLayout.body_name(model, j)
        better, change = settle(model.name or "the robot", name, tensor, options.inertias)
        if change:
            made.inertias[j] = pin.Inertia(body.mass, body.lever, better)
            changes[name] = change
    if changes:
        text = f"{model.name or 'the robot'}: {settled(changes, options.inertias)}"
        warnings.warn(text, FfsmsWarning, stacklevel=stacklevel)
    return made


def append(
    arm: Any, shapes: ShapePair, base: SatelliteBase, placement: Any, options: LoadOptions
) -> SpaceManipulator:
    """Return a satellite with the arm `arm` (pinocchio.Model) at `placement`.

    Links that are fixed to the universe of the arm's model are fixed to the satellite. `shapes` are the
    visual and the collision shapes of the arm, to which the satellite's shapes are added; None gives a robot
    without shapes. If the arm uses the name of the satellite's joint or of a frame of the satellite, a `_` is
    appended to the satellite's name.
    """
    _check_freedoms(arm)
    taken = {*arm.names, *(frame.name for frame in arm.frames)}
    model, own = satellite_model(base, taken)
    join = _Join(model, model.nframes - 1, placement, arm, options.locked or {})
    description = None
    if shapes is not None:
        for known, added in zip(own, shapes, strict=True):
            join.add_shapes(known, added)
        description = GivenShapes(*own)
    model.name = f"satellite_{arm.name or 'arm'}"
    box = (base.size, pin.SE3.Identity()) if options.base_size is None else (options.base_size, None)
    return _made(model, options, box, description)


def whole(
    robot: Any, options: LoadOptions, shapes: ShapePair, box: tuple[Any, Any] | None = None
) -> SpaceManipulator:
    """Return the robot that a pinocchio.Model with a free-flyer root describes.

    `box` has size [m] and pose of the base's box in the root frame. Without it, the size is that of `options`
    or of a box among the shapes of the base.
    """
    JointLayout(robot)  # checks the free-flyer, and that other joints have one degree of freedom
    model = pin.Model()
    join = _Join(model, 0, pin.SE3.Identity(), robot, options.locked or {})
    model.name, description, box = robot.name, None, box or (options.base_size, None)
    if shapes is not None:
        own = [pin.GeometryModel(), pin.GeometryModel()]
        for known, added in zip(own, shapes, strict=True):
            join.add_shapes(known, added)
        description = GivenShapes(*own)
        if box[0] is None:
            box = _base_box(model, own)
    return _made(model, options, box, description)


def joined(
    robots: Sequence[SpaceManipulator], prefixes: Sequence[str], base: SatelliteBase, options: LoadOptions
) -> SpaceManipulator:
    """Merge robots, each with one arm on an equal satellite, into one robot.

    Each prefix is put before the names of the joints and frames of one arm.
    """
    satellite, _ = satellite_model(base)
    model, own, drawn = pin.Model(), [pin.GeometryModel(), pin.GeometryModel()], False
    parameters = satellite.inertias[1].toDynamicParameters() * (1.0 - len(robots))
    for i, (sms, prefix) in enumerate(zip(robots, prefixes, strict=True)):
        join = _Join(model, 0, pin.SE3.Identity(), _prefixed(sms.model, prefix), {}, shared=i > 0)
        parameters = parameters + sms.model.inertias[1].toDynamicParameters()
        if sms.description is not None:
            drawn = True
            kinds: tuple[ShapeKind, ...] = ("visual", "collision")
            for known, kind in zip(own, kinds, strict=True):
                join.add_shapes(known, sms.geometry(kind))
    model.inertias[1] = pin.Inertia.FromDynamicParameters(parameters)
    model.name = "_".join(["satellite", *(sms.model.name.removeprefix("satellite_") for sms in robots)])
    box = (base.size, pin.SE3.Identity()) if options.base_size is None else None
    return whole(model, options, tuple(own) if drawn else None, box)


def _prefixed(model: Any, prefix: str) -> Any:
    """Copy a robot's model, with a prefix before the names of the arm's joints and frames."""
    made = model.copy()
    for j in range(2, made.njoints):
        made.names[j] = prefix + made.names[j]
    for frame in list(made.frames)[_SATELLITE_FRAMES:]:
        frame.name = prefix + frame.name
    return made


def _base_box(model: Any, shapes: list[Any]) -> tuple[Any, Any]:
    """Return the size [m] and pose of the base link's first collision box, else of its first visual box.

    Only boxes on frames that coincide with the root frame count. Size and pose are None if there is no box.
    """
    for item in (item for kind in reversed(shapes) for item in kind.geometryObjects):
        carrier = model.frames[item.parentFrame]
        if item.parentJoint == 1 and carrier.placement.isIdentity() and isinstance(item.geometry, coal.Box):
            return 2.0 * np.array(item.geometry.halfSide), item.placement
    return None, None


def _made(
    model: Any, options: LoadOptions, box: tuple[Any, Any], shapes: GivenShapes | None
) -> SpaceManipulator:
    set_limits(model, options, DEFAULT_RATE)
    return SpaceManipulator(model, options.end_effector, *box, options.acceleration, description=shapes)


def _check_freedoms(arm: Any) -> None:
    """Check that the arm has a joint and that each joint has one degree of freedom."""
    name = arm.name or "the arm"
    if arm.njoints < 2:
        raise UnsupportedJoint(name, "the model has no joint; an arm needs at least one")
    for j in range(1, arm.njoints):
        joint, freedoms = f"joint '{arm.names[j]}'", arm.joints[j].nv
        if freedoms == 6 and arm.parents[j] == 0:
            problem = f"{joint} is a free-flyer, but the satellite already has one; remove it from the arm"
            raise UnsupportedJoint(name, problem)
        if freedoms != 1:
            message = f"{joint} has {freedoms} degrees of freedom; only joints with one are supported"
            raise UnsupportedJoint(name, message)


def _positions(arm: Any, locked: Mapping[str, float]) -> dict[int, Any]:
    """Map the index of each locked joint to its position, as the entries (1,) or (2,) of Pinocchio's q."""
    names = [arm.names[j] for j in range(1, arm.njoints) if arm.joints[j].nv == 1]  # not the free-flyer
    positions = {}
    for name, position in locked.items():
        if name not in names:
            raise InvalidValue("locked", name, f"names no moving joint of the arm ({', '.join(names)})")
        place = number(f"locked['{name}']", position)
        j = arm.getJointId(name)
        # The position of a continuous joint in q is its cosine and sine.
        positions[j] = np.array([place] if arm.joints[j].nq == 1 else [np.cos(place), np.sin(place)])
    if len(positions) == len(names):
        raise UnsupportedJoint(arm.name or "the arm", "every joint is locked; an arm needs one that moves")
    return positions


class _Join:
    """The attachment of an arm to a model, at a placement on a frame; locked joints become fixed.

    `pinocchio.appendModel` is not used, because it drops rotor inertias (`armature`) and refuses a joint and
    a body with the same name. If `shared` is True, both models begin with the frames of the same satellite,
    and the arm's free-flyer and satellite are not added again.
    """

    def __init__(
        self,
        model: Any,
        frame: int,
        placement: Any,
        arm: Any,
        locked: Mapping[str, float],
        shared: bool = False,
    ) -> None:
        positions, data, q = _positions(arm, locked), arm.createData(), pin.neutral(arm)
        for j, position in positions.items():
            k = arm.joints[j].idx_q
            q[k : k + len(position)] = position
        pin.forwardKinematics(arm, data, q)
        carrier = model.frames[frame]
        # For each joint of the arm: the joint of the model to which its frame is fixed, and the frame's pose.
        self._at = {0: (carrier.parentJoint, carrier.placement * placement)}
        self._frames = {0: frame}
        self._skipped = _SATELLITE_FRAMES if shared else 0
        if shared:
            self._at[1], self._frames = (1, pin.SE3.Identity()), {i: i for i in range(_SATELLITE_FRAMES)}
        for j in range(2 if shared else 1, arm.njoints):
            parent, on = self._at[arm.parents[j]]
            if j in positions:
                self._at[j] = parent, on * data.liMi[j]
            else:
                new = model.addJoint(parent, arm.joints[j], on * arm.jointPlacements[j], arm.names[j])
                self._copy_numbers(model, new, arm, j)
                self._at[j] = new, pin.SE3.Identity()
        for j, (parent, on) in self._at.items():
            if shared and j == 1:
                continue
            if arm.inertias[j].mass != 0.0 or np.any(arm.inertias[j].inertia):
                model.appendBodyToJoint(parent, arm.inertias[j], on)
        taken = {(item.name, item.type) for item in model.frames}
        for i, item in enumerate(arm.frames):
            if i < max(1, self._skipped):
                continue  # the universe, and the frames of a shared satellite
            parent, on = self._at[item.parentJoint]
            fixed = item.type == pin.FrameType.JOINT and item.parentJoint in positions
            kind = pin.FrameType.FIXED_JOINT if fixed else item.type
            name = unused(item.name, {name for name, other in taken if other == kind})
            taken.add((name, kind))
            below = self._frames.get(item.parentFrame, frame)
            made = pin.Frame(name, parent, below, on * item.placement, kind, item.inertia)
            self._frames[i] = model.addFrame(made, False)

    @staticmethod
    def _copy_numbers(model: Any, new: int, arm: Any, j: int) -> None:
        to, of = model.joints[new], arm.joints[j]
        for names, a, b, length in (
            (_PER_VELOCITY, to.idx_v, of.idx_v, of.nv),
            (_PER_POSITION, to.idx_q, of.idx_q, of.nq),
        ):
            for name in names:
                values = np.array(getattr(model, name))
                values[a : a + length] = np.array(getattr(arm, name))[b : b + length]
                setattr(model, name, values)

    def add_shapes(self, shapes: Any, added: Any) -> None:
        """Append the arm's shapes `added` to the model's `shapes`."""
        taken = {item.name for item in shapes.geometryObjects}
        for item in added.geometryObjects:
            if item.parentFrame < self._skipped:
                continue
            made = item.copy()
            parent, on = self._at[item.parentJoint]
            made.name = unused(item.name, taken)
            taken.add(made.name)
            made.parentJoint, made.parentFrame = parent, self._frames.get(item.parentFrame, 0)
            made.placement = on * item.placement
            shapes.addGeometryObject(made)
