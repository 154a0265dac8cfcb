"""The shapes of a scene other than the robot, with colours and the encoding for Meshcat's page."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import umsgpack
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.files import LARGEST_DATA, read_content

COLOURS = {
    "target": "#D55E00",
    "tracked": "#F2F2F2",
    "base_linear": "#CC79A7",
    "base_turn": "#AA4499",
    "principal": "#009E73",
    "direction": "#F2F2F2",
    "start": "#E69F00",
    "end": "#56B4E9",
    "trail": "#777777",
    "obstacle": "#A03030",
    "client": "#C9A227",
    "wheels": "#8496A9",
    "thrusters": "#77808C",
    "cells": "#1E3A6E",
    "gaps": "#B9BEC6",
    "grapple": "#D8DDE3",
    "contact": "#E6194B",
    "event": "#0072B2",
    "stop": "#D00000",
}

AXIS_COLOURS = ("#D55E00", "#009E73", "#0072B2")  # x, y, z
# Colours for (1 + cos(theta_a)) / 2: 0 away from the target, 0.5 perpendicular, 1 towards the target.
ASSISTANCE_STOPS = ("#8C3A00", "#B5B0A8", "#0072B2")
# Colours for the share of a limit, or of a clearance, that is used, 0 to 1.
USAGE_STOPS = ("#56B4E9", "#F0E442", "#D55E00")
# MessagePack extension types of arrays in Meshcat's page.
_TYPES = {"uint8": 0x12, "uint32": 0x16, "float32": 0x17}
_SIDES = 20
_SHARP = 200  # largest number of triangles of a mesh with sharp edges; larger meshes are shaded smoothly
INSIDE = 0.985  # scale of an object that may coincide with another object, because coincident faces flicker


def rgb(colour: str) -> FloatArray:
    """Return red, green and blue (3,), 0 to 1, of "#RRGGBB"."""
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def pale(colour: str, strength: float) -> FloatArray:
    """Return a colour (3,) between white (0) and "#RRGGBB" (1)."""
    return np.asarray(1.0 - strength * (1.0 - rgb(colour)))


def blend(stops: tuple[str, ...], places: FloatArray | float) -> FloatArray:
    """Return the colours (..., 3) of a gradient at `places` (...) from 0 to 1."""
    at, columns = np.linspace(0.0, 1.0, len(stops)), np.array([rgb(stop) for stop in stops]).T
    return np.stack([np.interp(places, at, column) for column in columns], axis=-1)


class Mesh(NamedTuple):
    """A mesh: vertices (k, 3) [m], triangles (m, 3), and each vertex's coordinate along the shape, 0 to 1."""

    vertices: FloatArray
    faces: np.ndarray[tuple[int, int], np.dtype[np.int64]]
    along: FloatArray

    def geometry(self, colours: FloatArray | None) -> dict[str, Any]:
        """Return the geometry in the format of three.js, with colours (k, 3) of the vertices or None."""
        attributes = {"position": _attribute(self.vertices.astype(np.float32))}
        if colours is not None:
            attributes["color"] = _attribute(colours.astype(np.float32))
        data = {"attributes": attributes, "index": _attribute(self.faces.astype(np.uint32))}
        return {"type": "BufferGeometry", "data": data}


def tube(path: FloatArray, radii: FloatArray | float, sides: int = 8) -> Mesh:
    """Make a tube around a path (k, 3) with one radius or a radius per point, zero for a tip."""
    k = len(path)
    radius = np.broadcast_to(radii, (k,))
    tangents = np.gradient(path, axis=0)
    # A path that reverses has a zero tangent, which cannot be normalized.
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1), 1e-12)[:, None]
    normal = _any_normal(tangents[0])
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    rings = []
    for place, tangent, r in zip(path, tangents, radius, strict=True):
        normal = normal - (normal @ tangent) * tangent  # rotate the normal without twist about the path
        length = float(np.linalg.norm(normal))
        normal = normal / length if length > 1e-9 else _any_normal(tangent)
        across = np.cross(tangent, normal)
        rings.append(place + r * (np.cos(angles)[:, None] * normal + np.sin(angles)[:, None] * across))
    j = np.arange(sides)
    following, rows = (j + 1) % sides, sides * np.arange(k - 1)[:, None]
    here, beside = (rows + j).ravel(), (rows + following).ravel()
    mantle = [here, beside, beside + sides, here, beside + sides, here + sides]
    first, last, end = np.full(sides, k * sides), np.full(sides, k * sides + 1), (k - 1) * sides
    ends = [first, following, j, last, end + j, end + following]
    faces = np.vstack([np.column_stack(part).reshape(-1, 3) for part in (mantle, ends)])
    along = np.append(np.repeat(np.linspace(0.0, 1.0, k), sides), [0.0, 1.0])
    return Mesh(np.vstack([*rings, path[0], path[-1]]), faces, along)


def arrow(radius: float) -> Mesh:
    """Make an arrow of length 1 from the origin along z."""
    path = np.array([[0.0, 0.0, z] for z in (0.0, 0.74, 0.74, 1.0)])
    # The radius jumps between two nearly coincident points, because `tube` needs distinct points.
    path[2, 2] += 1e-6
    return tube(path, np.array([radius, radius, 2.6 * radius, 0.0]), _SIDES)


def turn_arrow(radius: float) -> Mesh:
    """Make a curved arrow of radius 1 about z, in the direction of a positive rotation."""
    angles = np.append(np.linspace(0.0, 1.35 * np.pi, 40), np.linspace(1.35 * np.pi, 1.6 * np.pi, 10))
    radii = np.append(np.full(40, radius), np.linspace(2.8 * radius, 0.0, 10))
    return tube(np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)]), radii, 12)


def cone() -> Mesh:
    """Make the lateral surface of a cone with its tip at the origin, height 1 along z and radius 1."""
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.ones(48)])
    faces = np.array([[0, 1 + j, 1 + (j + 1) % 48] for j in range(48)])
    return Mesh(np.vstack([np.zeros(3), rim]), faces, np.append(0.0, np.ones(48)))


def nozzle(length: float) -> Mesh:
    """Make a bell-shaped nozzle from the origin along z, which is widest at its end."""
    z = np.linspace(0.0, length, 8)
    radii = length * (0.12 + 0.33 * np.sqrt(z / length))
    return tube(np.column_stack([np.zeros((8, 2)), z]), radii, _SIDES)


def panel(length: float, width: float) -> tuple[Mesh, FloatArray]:
    """Return a flat panel in the x-y plane about the origin, and the colours (k, 3) of cells and gaps."""
    edges, cells = [], []
    for side in (length, width):
        count = max(2, round(6.0 * side / max(length, width)))
        starts, cell = np.linspace(-0.45 * side, 0.45 * side, count, endpoint=False), 0.84 * side / count
        edges.append(np.sort([*starts, *(starts + cell)]))
        cells.append(np.arange(2 * count - 1) % 2 == 0)
    corners, colours = [], []
    for i, j in np.ndindex(len(cells[0]), len(cells[1])):
        (a, b), (c, d) = edges[0][i : i + 2], edges[1][j : j + 2]
        corners += [[a, c, 0.0], [b, c, 0.0], [b, d, 0.0], [a, d, 0.0]]
        colours += 4 * [rgb(COLOURS["cells"] if cells[0][i] and cells[1][j] else COLOURS["gaps"])]
    first = 4 * np.arange(len(corners) // 4)[:, None, None]
    faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return Mesh(np.array(corners), faces, np.zeros(len(corners))), np.array(colours)


def hull(points: FloatArray) -> Mesh:
    """Make the convex hull of points (k, 3); triangles are counter-clockwise from outside."""
    from scipy.spatial import ConvexHull  # slow to load

    polytope = ConvexHull(points)
    faces = polytope.simplices.astype(np.int64)
    a, b, c = (points[faces[:, i]] for i in range(3))
    inward = np.einsum("kx,kx->k", np.cross(b - a, c - a), polytope.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    if len(faces) <= _SHARP:  # triangles without common vertices are shaded flat
        points, faces = points[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    else:  # interior points are left out
        corners, faces = np.unique(faces, return_inverse=True)
        points, faces = points[corners], faces.reshape(-1, 3)
    return Mesh(points, faces, np.zeros(len(points)))


def along_z(direction: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that maps z to a direction; the identity if the direction vanishes."""
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        return np.eye(3)
    z = direction / length
    x = _any_normal(z)
    return np.column_stack([x, np.cross(z, x), z])


def _any_normal(direction: FloatArray) -> FloatArray:
    """Return a unit vector perpendicular to a unit vector."""
    axis = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    normal = np.cross(axis, direction)
    return np.asarray(normal / np.linalg.norm(normal))


def packed(numbers: NDArray[Any]) -> Any:
    """Encode an array for Meshcat's page."""
    return umsgpack.Ext(_TYPES[numbers.dtype.name], numbers.tobytes())


def _attribute(rows: NDArray[Any]) -> dict[str, Any]:
    """Return an array (k, 3) as an attribute of three.js."""
    kind = f"{rows.dtype.name.capitalize()}Array"
    return {"itemSize": 3, "type": kind, "array": packed(rows), "normalized": False}


def sphere(radius: float) -> dict[str, Any]:
    """Return a sphere as a geometry of three.js."""
    return {"type": "SphereGeometry", "radius": radius, "widthSegments": 20, "heightSegments": 20}


def mesh_file(path: Path) -> dict[str, Any]:
    """Return an OBJ or STL file as a geometry for the page."""
    content, kind = read_content(path, LARGEST_DATA), path.suffix[1:].lower()
    text = kind == "obj"
    data = content.decode("utf-8", "replace") if text else packed(np.frombuffer(content, np.uint8))
    return {"type": "_meshfile_geometry", "format": kind, "data": data}
