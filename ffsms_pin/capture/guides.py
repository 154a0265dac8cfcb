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

_SIZES = 1e-4, 100.0  # [m] smallest and largest dimension; qhull fails on much flatter shapes
_NARROW = 0.75  # share of a cone's length, from the entry on, in which plans keep the full clearance
_MOST_SIDES = 360  # largest number of sides of a polygon, one per degree


class Scene(NamedTuple):
    """The contact shapes of an end effector and of a client, and the grasp.

    Attributes
    ----------
    load : SurfaceContact
        The contact load between end effector and client, for `simulate(..., loads=...)`.
    grasp : pinocchio.SE3
        The pose of the end-effector frame at the grasp, in the client's body frame.
    shapes : tuple of Shape
        All convex pieces of the nozzle or ring in the client's body frame, for `Client(shapes=...)`.
    walls : tuple of Shape
        The convex pieces, in the client's body frame, from which plans keep the end effector clear.
    """

    load: SurfaceContact
    grasp: Any
    shapes: tuple[Shape, ...]
    walls: tuple[Shape, ...]

    @property
    def hull(self) -> Any:
        """The convex hull of `shapes`, a coal geometry in the client's body frame.

        A cylinder is replaced by its bounding box.
        """
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
    """Make a probe and a nozzle, whose cone guides the probe into the throat.

    The probe is a rod with round ends. The end-effector frame is at the tip, z along the rod and outward. The
    cone narrows from its entry to the throat, a tube with a floor. The cross-sections are polygons whose
    inscribed circles have the given radii, so walls are flat. Each side is a convex piece, and so is the
    floor. The default dimensions are those of github.com/biorobotics/on_orbit, with a radial play of 1.4 mm
    in the throat.

    Parameters
    ----------
    place : pinocchio.SE3
        The nozzle frame in the client's body frame: origin in the centre of the entry, z into the nozzle.
    probe_length, probe_radius, entry_radius, throat_radius, cone_length, throat_length : float
        The dimensions [m], see `Nozzle`.
    depth : float
        The depth of the tip in the throat at the grasp [m].
    sides : int
        The number of sides of the polygons, 3 to 360.
    stiffness, exponent : float
        Contact parameters, see `SurfaceContact`. The default stiffness is the bending stiffness 3 E I / L^3
        of a steel rod (E = 200 GPa), which is much softer than its surface.
    **surface
        `damping`, `friction` and `transition` of `SurfaceContact`.

    Raises
    ------
    InvalidValue
        If a dimension or a parameter of `surface` is out of range, or the probe does not fit.
    """
    place = checks.pose("place", place)
    _check_sizes(
        probe_length=probe_length, probe_radius=probe_radius, entry_radius=entry_radius,
        throat_radius=throat_radius, cone_length=cone_length, throat_length=throat_length,
    )  # fmt: skip
    if not probe_radius < throat_radius < entry_radius:
        message = f"must lie between probe_radius, {probe_radius:g} m, and entry_radius, {entry_radius:g} m"
        raise InvalidValue("throat_radius", throat_radius, message)
    if not 2.0 * probe_radius < probe_length:
        message = f"must be more than twice the probe_radius of {probe_radius:g} m"
        raise InvalidValue("probe_length", probe_length, message)
    if not 0.0 <= checks.number("depth", depth) <= throat_length:
        raise InvalidValue("depth", depth, f"must lie between 0 and throat_length, {throat_length:g} m")
    rod = coal.Capsule(probe_radius, probe_length - 2.0 * probe_radius)
    probe = (rod, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * probe_length])))
    end, wall = cone_length + throat_length, 0.5 * throat_radius
    # The profile of a wall is convex, with a straight outside.
    profile = np.array([
        [entry_radius, 0.0], [throat_radius, cone_length], [throat_radius, end],
        [throat_radius + wall, end], [entry_radius + wall, 0.0],
    ])  # fmt: skip
    floor = coal.Cylinder(throat_radius + wall, wall)
    pieces = _body(profile, "sides", sides, 3, place)
    pieces.append((floor, place * pin.SE3(np.eye(3), np.array([0.0, 0.0, end + 0.5 * wall]))))
    load = SurfaceContact([probe], pieces, stiffness, exponent, **surface)
    grasp = place * pin.SE3(np.eye(3), np.array([0.0, 0.0, cone_length + depth]))
    # Plans keep the full clearance from the front part of a wall, and less from the narrow rear part.
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

    Each finger's pad consists of four balls at the corners of a square, and the palm of two balls, because
    the contact points of balls do not jump. The end-effector frame is in the centre of the pads: z towards
    the client, y from finger to finger, outward along the ring's radius. Only the gripped segment of the ring
    and its two neighbours have contact. If `opening` is less than the ring's thickness, the pads squeeze the
    ring. Pass such a load to the event `Close`, so that it acts only after the gripper has closed.

    Parameters
    ----------
    place : pinocchio.SE3
        The ring frame in the client's body frame: origin in the centre of the rim, z out of the client. The
        ring is gripped on its x axis.
    opening : float
        The distance between the fingers' pads [m]. The default leaves 17.5 mm on either side of the rim.
    ring_radius, thickness, height : float
        The radius to the middle of the wall, and the thickness and height of the wall [m]. The default
        radius is that of a 1194 mm adapter.
    reach : float
        The distance from the palm to the middle of the pads [m].
    pad, pad_radius : float
        The distance between neighbouring balls of a pad, and the radius of the balls [m].
    segments : int
        The number of flat segments of the ring, 8 to 360.
    **surface
        Parameters of `SurfaceContact` such as `stiffness`. The default stiffness is that of silicone pads.

    Raises
    ------
    InvalidValue
        If a dimension or a parameter of `surface` is out of range.
    """
    place = checks.pose("place", place)
    _check_sizes(
        opening=opening, ring_radius=ring_radius, thickness=thickness, height=height, reach=reach, pad=pad,
        pad_radius=pad_radius,
    )  # fmt: skip
    if not thickness < ring_radius:
        raise InvalidValue("thickness", thickness, f"must be below ring_radius, {ring_radius:g} m")
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
    """Return the corners (k, 3) of a polyhedron, or of the bounding box of another geometry."""
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
    """Return the sides of a polygonal body about z, each a geometry and its placement.

    `profile` (k, 2) has the columns radius and z [m].
    """
    if not least <= checks.whole(name, sides, least) <= _MOST_SIDES:
        raise InvalidValue(name, sides, f"must be at most {_MOST_SIDES}")
    half = np.tan(np.pi / sides)
    side = hull_of(np.array([[r, sign * r * half, z] for r, z in profile.tolist() for sign in (-1.0, 1.0)]))
    turns = [pin.exp3(np.array([0.0, 0.0, 2.0 * np.pi * k / sides])) for k in range(sides)]
    return [(side, place * pin.SE3(turn, np.zeros(3))) for turn in turns]
