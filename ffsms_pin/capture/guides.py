"""Contact scenes of convex pieces: a gripper on a ring and a probe in a nozzle."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.capture.surface_contact import SurfaceContact
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Shape
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.convex_parts import hull_of

_SIZES = 1e-4, 100.0  # [m] least and greatest size; qhull fails on far flatter shapes
_NARROW = 0.75  # share of a cone's length beyond which a probe may come nearer to it than the clearance
_MOST_SIDES = 360  # sides of a polygon, one per degree


class Scene(NamedTuple):
    """Two sets of contact shapes, with the grasp at which they fit.

    Attributes
    ----------
    load : SurfaceContact
        The contact load for `simulate(..., loads=...)`, between its `tool_shapes` and `client_shapes`.
    grasp : pinocchio.SE3
        The pose of the end-effector frame at the grasp, in the client's body axes.
    shapes : tuple of Shape
        The complete shapes of the client's part, in body axes, for `Client(shapes=...)`, viewer and
        clearance.
    walls : tuple of Shape
        The pieces of these shapes from which plans keep a tool clear, in body axes.
    """

    load: SurfaceContact
    grasp: Any
    shapes: tuple[Shape, ...]
    walls: tuple[Shape, ...]

    @property
    def hull(self) -> Any:
        """The convex hull of the client's part, a coal geometry in body axes."""
        corners = [
            _corners(geometry) @ place.rotation.T + place.translation for geometry, place in self.shapes
        ]
        return hull_of(np.concatenate(corners))


def probe_in_nozzle(
    place: Any,
    probe_length: float = 0.72,
    probe_radius: float = 0.008,
    entry_radius: float = 0.142,
    throat_radius: float = 0.0094,
    cone_length: float = 0.4285,
    throat_length: float = 0.0445,
    depth: float = 0.037,
    sides: int = 8,
    stiffness: float = 5e3,
    exponent: float = 1.0,
    **surface: float,
) -> Scene:
    """Make a rod with a round tip, and a nozzle whose cone guides it into the throat.

    The end-effector frame is at the tip, z along the rod and outward. The cone narrows from its entry to the
    throat, a tube with a floor. The cross-sections are polygons whose inscribed circles have the given radii,
    so walls are flat. There is one convex piece a side, thick enough that no rod passes through, and the
    floor. The default dimensions are those of github.com/biorobotics/on_orbit: a play of 1.4 mm in the
    throat.

    Parameters
    ----------
    place : pinocchio.SE3
        The nozzle frame in the client's body axes: origin in the centre of the entry, z into the nozzle.
    probe_length, probe_radius, entry_radius, throat_radius, cone_length, throat_length : float
        [m]
    depth : float
        The depth of the tip in the throat at the grasp [m].
    sides : int
        The number of sides of the polygons, at least three.
    stiffness, exponent : float
        Contact parameters, see `SurfaceContact`. The defaults are the bending stiffness 3 E I / L^3 of a
        steel rod (200 GPa), far below that of its surface.
    **surface
        `damping`, `friction` and `transition` of `SurfaceContact`.

    Raises
    ------
    InvalidValue
        If a dimension is not above zero, the probe does not fit, or a parameter of `surface` is out of range.
    """
    place = checks.pose("place", place)
    _check_sizes(
        probe_length=probe_length, probe_radius=probe_radius, entry_radius=entry_radius,
        throat_radius=throat_radius, cone_length=cone_length, throat_length=throat_length,
    )  # fmt: skip
    if not probe_radius < throat_radius < entry_radius:
        raise InvalidValue(
            "throat_radius", throat_radius, "must lie between the radii of the probe and the entry"
        )
    if not 2.0 * probe_radius < probe_length:
        raise InvalidValue("probe_length", probe_length, "must be more than twice the probe's radius")
    if not 0.0 <= checks.number("depth", depth) <= throat_length:
        raise InvalidValue("depth", depth, "must lie within the throat's length [m]")
    rod = coal.Capsule(probe_radius, probe_length - 2.0 * probe_radius)
    probe = (rod, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * probe_length])))
    end, wall = cone_length + throat_length, 0.5 * throat_radius
    # The profile runs down the inside and back up the outside; the protruding lip makes it convex.
    profile = np.array([
        [entry_radius, 0.0], [throat_radius, cone_length], [throat_radius, end],
        [throat_radius + wall, end], [entry_radius + wall, 0.0],
    ])  # fmt: skip
    floor = coal.Cylinder(throat_radius + wall, wall)
    pieces = _body(profile, "sides", sides, 3, place)
    pieces.append((floor, place * pin.SE3(np.eye(3), np.array([0.0, 0.0, end + 0.5 * wall]))))
    load = SurfaceContact([probe], pieces, stiffness, exponent, **surface)
    grasp = place * pin.SE3(np.eye(3), np.array([0.0, 0.0, cone_length + depth]))
    # The part of a wall in front of the narrow stretch keeps the full clearance, the part behind less.
    deep = _NARROW * cone_length
    inner = entry_radius + _NARROW * (throat_radius - entry_radius)
    front = np.array([[entry_radius, 0.0], [inner, deep], [inner + wall, deep], [entry_radius + wall, 0.0]])
    rear = np.array([[inner, deep], *profile[1:4], [inner + wall, deep]])
    walls = [*_body(front, "sides", sides, 3, place), *_body(rear, "sides", sides, 3, place), pieces[-1]]
    return Scene(load, grasp, tuple(load.client_shapes), tuple(Shape(*shape) for shape in walls))


def gripper_on_ring(
    place: Any,
    opening: float = 0.04,
    ring_radius: float = 0.597,
    thickness: float = 0.005,
    height: float = 0.06,
    reach: float = 0.025,
    pad: float = 0.04,
    pad_radius: float = 0.01,
    segments: int = 36,
    **surface: float,
) -> Scene:
    """Make a gripper of two fingers and a palm, and the rim of a launch adapter ring.

    Each finger's pad is four balls at the corners of a square, the palm two, so the rim is held in all
    directions and no contact point jumps. The end-effector frame is in the centre of the pads: z towards the
    ring, y from finger to finger, along the ring's radius. Only the gripped segment of the ring and its
    neighbours have contact. An `opening` below the ring's thickness squeezes it; such a load belongs in
    `Close`.

    Parameters
    ----------
    place : pinocchio.SE3
        The ring frame in the client's body axes: origin in the centre of the rim, z out of the client. The
        ring is gripped on its x axis.
    opening : float
        The distance between the fingers' pads [m]. The default leaves 17 mm on either side of the rim.
    ring_radius, thickness, height : float
        The radius of the wall's middle, and the thickness and height of the wall [m]. The default radius is
        that of a 1194 mm adapter.
    reach : float
        The distance from the palm to the middle of the pads [m].
    pad, pad_radius : float
        The side of the square, and the radius of the balls [m].
    segments : int
        The number of flat segments of the ring, at least eight.
    **surface
        `stiffness` and other parameters of `SurfaceContact`; the defaults are those of silicone pads.

    Raises
    ------
    InvalidValue
        If a dimension is not above zero, or a parameter of `surface` is out of range.
    """
    place = checks.pose("place", place)
    _check_sizes(
        opening=opening, ring_radius=ring_radius, thickness=thickness, height=height, reach=reach, pad=pad,
        pad_radius=pad_radius,
    )  # fmt: skip
    if not thickness < ring_radius:
        raise InvalidValue("thickness", thickness, "must be below the ring's radius [m]")
    ball, half, away = coal.Sphere(pad_radius), 0.5 * pad, 0.5 * opening + pad_radius
    corners = [(x, y, z) for x in (-half, half) for y in (-away, away) for z in (-half, half)]
    palm = [(x, 0.0, -reach - pad_radius) for x in (-half, half)]
    balls = [(ball, pin.SE3(np.eye(3), np.array(at))) for at in (*corners, *palm)]
    inner, outer = ring_radius - 0.5 * thickness, ring_radius + 0.5 * thickness
    profile = np.array([[inner, 0.0], [outer, 0.0], [outer, -height], [inner, -height]])
    ring = _body(profile, "segments", segments, 8, place)
    load = SurfaceContact(balls, [ring[-1], ring[0], ring[1]], **surface)
    turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    grasp = place * pin.SE3(turn, np.array([ring_radius, 0.0, -reach]))
    return Scene(load, grasp, tuple(Shape(*shape) for shape in ring), tuple(load.client_shapes))


def _corners(geometry: Any) -> FloatArray:
    """Return corners (k, 3) whose hull contains a geometry: those of a polyhedron, or of its bounding box."""
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points())
    geometry.computeLocalAABB()
    low, high = (np.array(end) for end in (geometry.aabb_local.min_, geometry.aabb_local.max_))
    return np.array([np.where(side, high, low) for side in np.ndindex(2, 2, 2)])


def _check_sizes(**sizes: float) -> None:
    for name, value in sizes.items():
        if not _SIZES[0] <= checks.positive(name, value, "m") <= _SIZES[1]:
            raise InvalidValue(name, value, f"must lie between {_SIZES[0]:g} and {_SIZES[1]:g} m")


def _body(profile: FloatArray, name: str, sides: Any, least: int, place: Any) -> list[tuple[Any, Any]]:
    """Return the sides of a polygonal body about z from a profile (k, 2) of radius and z."""
    if not least <= checks.whole(name, sides, least) <= _MOST_SIDES:
        raise InvalidValue(name, sides, f"must be at most {_MOST_SIDES}")
    half = np.tan(np.pi / sides)
    side = hull_of(np.array([[r, sign * r * half, z] for r, z in profile.tolist() for sign in (-1.0, 1.0)]))
    turns = [pin.exp3(np.array([0.0, 0.0, 2.0 * np.pi * k / sides])) for k in range(sides)]
    return [(side, place * pin.SE3(turn, np.zeros(3))) for turn in turns]
