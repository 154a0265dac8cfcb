"""What acts on the plant from outside."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, number, one_of, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

__all__ = ["GeneralisedForce", "Wrench"]

# From t [s], q (nq,), v (6 + n,) to a generalised force (6 + n,).
GeneralisedForce: TypeAlias = Callable[[float, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Wrench:
    """An external force and moment on the base or the end effector.

    Parameters
    ----------
    wrench : array_like, shape (6,), or callable
        [force; moment] in inertial axes [N; N m], or a function of time [s] that gives it.
    on : {"base", "end-effector"}
        Where it acts: at the base's centre of mass, or at the end-effector frame's origin.
    start, end : float
        When it acts [s].
    """

    wrench: Any
    on: Literal["base", "end-effector"] = "base"
    start: float = 0.0
    end: float = math.inf

    def force(self, plant: SpaceManipulator) -> GeneralisedForce:
        """The generalised force, conjugate to Pinocchio's v."""
        one_of("wrench.on", self.on, ("base", "end-effector"))
        start, end = number("wrench.start", self.start), self.end
        if not (isinstance(end, (int, float)) and end > start):
            raise InvalidValue("wrench.end", end, f"must be after its start at {start:g} s")
        value = self.wrench if callable(self.wrench) else None
        fixed = np.zeros(6) if value is not None else vector("wrench", self.wrench, 6, "N, N m")
        model, data = plant.model, plant.model.createData()
        local, frame = plant.base_com, plant.frame_id

        def at(t: float) -> FloatArray:
            if not start <= t < end:
                return np.zeros(6)
            return fixed if value is None else vector(f"wrench at t = {t:g} s", value(t), 6, "N, N m")

        def on_base(t: float, q: FloatArray, v: FloatArray) -> FloatArray:
            F, rotation = at(t), pin.Quaternion(q[3:7]).toRotationMatrix()
            force = np.zeros(v.size)
            force[:3] = rotation.T @ F[:3]
            force[3:6] = rotation.T @ F[3:] + np.cross(local, force[:3])
            return force

        def on_end_effector(t: float, q: FloatArray, v: FloatArray) -> FloatArray:
            J = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            force: FloatArray = J.T @ at(t)
            return force

        return on_base if self.on == "base" else on_end_effector


def checked(disturbances: Any) -> tuple[Wrench, ...]:
    """The argument `disturbances` of `simulate`: one or several."""
    try:
        several = (disturbances,) if isinstance(disturbances, Wrench) else tuple(disturbances)
    except TypeError:
        raise InvalidValue("disturbances", disturbances, "must hold Wrench objects") from None
    for one in several:
        if not isinstance(one, Wrench):
            raise InvalidValue("disturbances", one, "must hold Wrench objects")
    return several


def later(given: Wrench, by: float) -> Wrench:
    """The same wrench in a run that begins `by` seconds after."""
    if callable(given.wrench):
        return replace(
            given, wrench=lambda t: given.wrench(t + by), start=given.start - by, end=given.end - by
        )
    return replace(given, start=given.start - by, end=given.end - by)
