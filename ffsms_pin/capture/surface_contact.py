"""Contact between convex shapes: normal force after Hunt and Crossley, and Coulomb friction.

Let d be the depth of the overlap of two shapes, d' its rate, and s the slip velocity at the point of contact.
The normal and the tangential force are

    f_n = k d^p (1 + 3/2 c d'),  not below zero,      f_t = mu f_n tanh(|s| / s_0) s / |s|.

`SurfaceContact` has the parameters. After a slow impact at the speed v, the coefficient of restitution is
1 - c v, for any p and any masses. The exponent p is 3/2 for smooth bodies (Hertz) and 1 for a structure that
bends.

References: K. H. Hunt, F. R. E. Crossley, "Coefficient of restitution interpreted as damping in vibroimpact",
Journal of Applied Mechanics 42 (1975). K. L. Johnson, "Contact Mechanics" (1985), chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import coal
import numpy as np

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client.client import cross, placed_shapes
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.convex_parts import Part, convex_shape, part_of
from ffsms_pin.simulation.loads import velocity_at


class Touch(NamedTuple):
    """The overlap of two shapes.

    Attributes
    ----------
    tool, client : int
        The indices of the shapes in `tool_shapes` and `client_shapes`.
    depth : float
        The depth of the overlap [m].
    point, normal : ndarray, shape (3,)
        The point midway between both surfaces [m], and the client's outward normal [1], inertial axes.
    force : ndarray, shape (3,)
        The force on the end effector [N], inertial axes.
    """

    tool: int
    client: int
    depth: float
    point: FloatArray
    normal: FloatArray
    force: FloatArray


@dataclass(frozen=True, eq=False)
class SurfaceContact:
    """A unilateral contact between convex shapes of end effector and client, a `Load`.

    Each pair of shapes has one contact point, at the deepest overlap. Between two flat faces this point can
    jump, and the torque with it, so one face should be modelled by rounded feet. A hollow shape or a ring is
    a set of convex pieces; at the seam of two flush pieces, both pieces push. The contact points of round
    shapes (spheres, capsules, shapes with a swept radius) are exact up to rounding while the overlap is
    smaller than the radius.

    Parameters
    ----------
    tool_shapes, client_shapes : sequence
        Coal geometries, or pairs of a geometry and its placement (pinocchio.SE3), such as `Client.shapes`.
        The placements are in the end-effector frame and in the client's body axes.
    stiffness : float
        k [N/m^p]. The default is about `2 * hertz_stiffness(0.01, 5e6, 0.48)`, for a silicone pad with a
        radius of 10 mm on metal.
    exponent : float
        p, from 1 to 10. Default: that of Hertz.
    damping : float
        c [s/m]. The default, for surfaces on a structure, gives a restitution of 80 % at 10 mm/s.
    friction : float
        mu. The default is a low value for metal on a dry coating.
    transition : float
        s_0 [m/s], the speed up to which surfaces creep in static friction. The default is a tenth of the
        speed of a slow docking. Steps of the Runge-Kutta integrator must be shorter than 2.7 m s_0 / (mu
        f_n), with the mass m behind the contact.

    Raises
    ------
    InvalidValue
        No shapes, a shape that is not convex, or a number out of its range.
    """

    tool_shapes: Sequence[Any]
    client_shapes: Sequence[Any]
    stiffness: float = 8.7e5
    exponent: float = 1.5
    damping: float = 20.0
    friction: float = 0.2
    transition: float = 1e-3
    _tool: tuple[Part, ...] = field(init=False, repr=False)
    _client: tuple[Part, ...] = field(init=False, repr=False)
    # _centres: the shapes' centres, (m, 3) in the end-effector frame and (k, 3) in body axes. _reach: the
    # squared distances (m, k) [m^2] between the centres of two shapes up to which the shapes can touch.
    _centres: tuple[FloatArray, FloatArray] = field(init=False, repr=False)
    _reach: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        checks.positive("stiffness", self.stiffness, "N/m^p")
        checks.positive("transition", self.transition, "m/s")
        checks.at_least_zero("damping", self.damping, "s/m")
        checks.at_least_zero("friction", self.friction)
        if not 1.0 <= checks.number("exponent", self.exponent) <= 10.0:
            raise InvalidValue("exponent", self.exponent, "must lie between 1 and 10")
        radii, centres = [], []
        for name, own in (("tool_shapes", "_tool"), ("client_shapes", "_client")):
            placed = placed_shapes(name, getattr(self, name))
            if not placed:
                raise InvalidValue(name, getattr(self, name), "must hold at least one shape")
            parts = tuple(part_of(convex_shape(name, shape), 0, place, True) for shape, place in placed)
            object.__setattr__(self, name, placed)
            object.__setattr__(self, own, parts)
            radii.append([part.radius for part in parts])
            centres.append(np.array([part.centre for part in parts]))
        object.__setattr__(self, "_centres", tuple(centres))
        object.__setattr__(self, "_reach", np.add.outer(*radii) ** 2)

    def touches(
        self, tool: Any, tool_twist: FloatArray, client: Any, client_twist: FloatArray
    ) -> list[Touch]:
        """Return all pairs of shapes that overlap; for the arguments see `Load.wrench`."""
        there = client.actInv(tool)
        own = self._centres[0] @ there.rotation.T + there.translation
        apart = own[:, None] - self._centres[1]
        near: list[list[int]] = np.argwhere(np.einsum("ikc,ikc->ik", apart, apart) <= self._reach).tolist()
        if not near:
            return []
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.gjk_tolerance = request.epa_tolerance = 1e-12
        here = coal.Transform3s(there.rotation, there.translation)
        placed = {i: here * self._tool[i].place for i, _ in near}
        touches = []
        for i, k in near:
            tool_part, client_part = self._tool[i], self._client[k]
            result.clear()
            depth = -coal.distance(
                tool_part.shape, placed[i], client_part.shape, client_part.place, request, result
            )
            if depth <= 0.0:
                continue
            point = client.act(0.5 * (result.getNearestPoint1() + result.getNearestPoint2()))
            normal = -client.rotation @ result.normal
            motion = velocity_at(point, client, client_twist) - velocity_at(point, tool, tool_twist)
            touches.append(Touch(i, k, depth, point, normal, self._force(depth, normal, motion)))
        return touches

    def _force(self, depth: float, normal: FloatArray, motion: FloatArray) -> FloatArray:
        """Return the force (3,) on the end effector; `motion` (3,) is the client's relative velocity."""
        rate = float(normal @ motion)
        push = self.stiffness * depth**self.exponent * max(0.0, 1.0 + 1.5 * self.damping * rate)
        slip = motion - rate * normal
        speed = math.hypot(*slip.tolist())
        drag = self.friction * push * math.tanh(speed / self.transition) / speed if speed else 0.0
        return np.asarray(push * normal + drag * slip)

    def wrench(
        self, tool: Any, tool_twist: FloatArray, client: Any, client_twist: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the sum of all contact wrenches, and its point of application: the end-effector position."""
        total, point = np.zeros(6), np.array(tool.translation)
        for touch in self.touches(tool, tool_twist, client, client_twist):
            total[:3] += touch.force
            total[3:] += cross(touch.point - point, touch.force)
        return total, point


def hertz_stiffness(radius: float, E: float, nu: float) -> float:
    """Return Hertz's stiffness k [N/m^1.5] of f = k d^1.5 for two bodies of one material.

    Parameters
    ----------
    radius : float
        The radius of a ball on a plane [m]; for two balls R_1 R_2 / (R_1 + R_2).
    E, nu : float
        Young's modulus [Pa] and Poisson's ratio of both bodies. If one body is much stiffer, k is twice the
        returned value.
    """
    if not -1.0 < nu <= 0.5:
        raise InvalidValue("nu", nu, "must be above -1 and at most 0.5")
    return 2.0 / 3.0 * E / (1.0 - nu**2) * math.sqrt(radius)
