"""The class `ShapedMechanism`: a mechanism with joint limits, a base box and shapes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import LONGEST, FloatArray, instance, one_of, pose, positives
from ffsms_pin.errors import GeometryError, InvalidValue
from ffsms_pin.geometry.convex_parts import Part, convex_parts
from ffsms_pin.geometry.shapes import ShapeKind, ShapeSource
from ffsms_pin.system import dynamics
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.mechanism import Mechanism, RobotLimits, limits_of, within_turns

_Made = TypeVar("_Made")


class ShapedMechanism(Mechanism):
    """A mechanism with joint limits, a base box and the shapes of its bodies.

    Users work with the subclass `SpaceManipulator`, which documents the parameters.
    """

    def __init__(
        self,
        model: Any,
        end_effector: str | None,
        base_size: ArrayLike | None = None,
        base_box_placement: Any = None,
        acceleration: ArrayLike | None = None,
        limits: RobotLimits | None = None,
        description: ShapeSource | None = None,
    ) -> None:
        super().__init__(model, end_effector)
        if limits is None:
            limits = limits_of(self.model, self.layout, acceleration)
        elif acceleration is not None:
            message = "cannot be used with `limits`, which has acceleration limits; pass only one of the two"
            raise InvalidValue("acceleration", acceleration, message)
        elif not isinstance(limits, RobotLimits) or limits.lower.shape != (self.n,):
            raise InvalidValue("limits", limits, f"must be a RobotLimits with {self.n} joints")
        self.limits = within_turns(limits, self.layout.turns)
        self.base_size = None if base_size is None else positives("base_size", base_size, 3, "m", LONGEST)
        box = pin.SE3(np.eye(3), self.base_com) if base_box_placement is None else base_box_placement
        self.base_box_placement = pose("base_box_placement", box)
        instance("description", description, ShapeSource, optional=True)
        self.description = description
        self._geometry, self._made = dict[Any, Any](), dict[Any, Any]()

    @property
    def joint_names(self) -> list[str]:
        """The names of the actuated joints, in the order of v; a new list."""
        return list(self.layout.names)

    @property
    def joint_damping(self) -> FloatArray:
        """The viscous friction (n,) of the joints, from the robot's model [N m s/rad or N s/m]."""
        return np.array(self.model.damping[6:])

    @property
    def joint_friction(self) -> FloatArray:
        """The dry friction (n,) of the joints, from the robot's model [N m or N]."""
        return np.array(self.model.upperDryFrictionLimit[6:])

    def arm_stack(self, mode: str = "floating") -> ArmStack:
        """Return the cached `ArmStack` of the robot in a mode of the base (see `opt.Problem`)."""
        one_of("mode", mode, dynamics.MODES)
        return self._once(("arm", mode), lambda: ArmStack(self, mode))

    def _once(self, key: Any, make: Callable[[], _Made], of_shapes: bool = False) -> _Made:
        """Return the result of `make`, cached under `key`.

        With `of_shapes`, later copies of the robot with other masses, limits, actuators or another end
        effector share the result.
        """
        kept: dict[Any, _Made] = self._geometry if of_shapes else self._made
        if key not in kept:
            kept[key] = make()
        return kept[key]

    def geometry(self, kind: ShapeKind) -> Any:
        """Return the visual or collision shapes of the robot, which are read once and cached.

        Parameters
        ----------
        kind : {"visual", "collision"}
            The shapes for viewers ("visual") or for collision checks ("collision").

        Returns
        -------
        pinocchio.GeometryModel
            The geometry of `model`. Copy it before you change it.

        Raises
        ------
        GeometryError
            A collision mesh is missing, a shape or the SRDF cannot be read, or the robot has no source of
            shapes.
        """
        one_of("kind", kind, ("visual", "collision"))
        if self.description is None:
            text = "the robot has no shapes: load it from a URDF, or pass visual= and collision= to load"
            raise GeometryError(text)
        return self._once(kind, partial(self.description.geometry, self.model, kind), of_shapes=True)

    def convex_parts(self) -> list[Part]:
        """Return the collision shapes, with meshes cut into convex parts; computed once and cached."""
        return self._once(Part, lambda: convex_parts(self.geometry("collision")), of_shapes=True)
