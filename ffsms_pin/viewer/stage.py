"""Where layers draw: a scene, the film that moves it, and how large things are."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as mg
import numpy as np
from meshcat.visualizer import Visualizer

from ffsms_pin.checks import FloatArray
from ffsms_pin.viewer.meshes import BACKGROUND, Mesh, as_number
from ffsms_pin.viewer.scene import Film, Scene

__all__ = ["ROOT", "Stage"]

ROOT = "/ffsms"
_GONE = 1e-6  # as small as a thing gets that is not there: a scale of zero has no inverse


class Stage:
    """A scene about a centre.

    Parameters
    ----------
    size : float
        About how large the robot is [m]; arrows and markers are shares of it.
    """

    def __init__(self, size: float) -> None:
        self.scene = Scene()
        self.film = Film()
        self.size = size
        self._opacity: dict[str, float] = {}
        # Meshcat asks for a window to a running server; the scene takes its place.
        self.root = Visualizer(window=self.scene)[ROOT]

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes at the top of what is drawn."""
        start = f"{ROOT}/"
        below = [path[len(start) :] for path in self.scene.paths if path.startswith(start)]
        return list(dict.fromkeys(path.split("/")[0] for path in below))

    def set_up(self, centre: FloatArray, camera: FloatArray) -> None:
        """Background, and a camera at `camera` (3,) from a centre (3,) that it looks at [m]."""
        self.root.set_transform(_shift(-centre))  # the page's camera turns about the origin
        self.root["/Background"].set_property("top_color", BACKGROUND[0])
        self.root["/Background"].set_property("bottom_color", BACKGROUND[1])
        for name in ("/Grid", "/Axes"):
            self.root[name].set_property("visible", False)
        x, y, z = (float(one) for one in camera)
        self.root["/Cameras/default/rotated/<object>"].set_property("position", [x, z, -y])  # there y is up

    def mesh(
        self,
        name: str,
        mesh: Mesh,
        colour: str | FloatArray,
        opacity: float = 1.0,
        flat: bool = False,
        through: bool = False,
    ) -> None:
        """Draw a mesh.

        Parameters
        ----------
        name : str
        mesh : Mesh
        colour : str or ndarray, shape (k, 3)
            One for all, or one a vertex.
        opacity : float
        flat : bool
            Leave out light and shade.
        through : bool
            Let it be seen through whatever is before it.
        """
        each = None if isinstance(colour, str) else colour
        self._opacity[name] = opacity
        shape = mg.TriangularMeshGeometry(mesh.vertices, mesh.faces, each)
        kind = mg.MeshBasicMaterial if flat else mg.MeshPhongMaterial
        material = kind(
            color=as_number(colour) if isinstance(colour, str) else 0xFFFFFF,
            opacity=opacity,
            transparent=opacity < 1.0 or through,  # what is transparent is drawn last
            vertexColors=each is not None,
            depthWrite=opacity == 1.0 and not through,
            depthTest=not through,
        )
        self.root[name].set_object(shape, material)
        if through:
            self._draw_late(name)

    def ball(self, name: str, radius: float, colour: str, opacity: float = 1.0) -> None:
        """Draw a ball about the node's origin, without light and shade, seen through what is before it."""
        self._opacity[name] = opacity
        material = mg.MeshBasicMaterial(
            color=as_number(colour), opacity=opacity, transparent=True, depthWrite=False, depthTest=False
        )
        self.root[name].set_object(mg.Sphere(radius), material)
        self._draw_late(name)

    def _draw_late(self, name: str) -> None:
        """Draw a mesh after all others, so that none that is transparent tints it."""
        self.scene.send(_Property(f"{ROOT}/{name}/<object>", "renderOrder", 1))

    def place(
        self, name: str, position: FloatArray, rotation: FloatArray | None = None, scale: Any = 1.0
    ) -> None:
        """Move a node: at once, or while the scene is filming, in that frame."""
        matrix = np.eye(4)
        size = np.broadcast_to(np.asarray(scale, dtype=np.float64), (3,))
        size = np.where(np.abs(size) < _GONE, _GONE, size)
        matrix[:3, :3] = (np.eye(3) if rotation is None else rotation) * size
        matrix[:3, 3] = position
        self.root[name].set_transform(matrix)

    def follow(
        self, name: str, times: FloatArray, positions: FloatArray, rotations: FloatArray | None = None
    ) -> None:
        """Place a node as at the first of times (k,) [s], and film it through all of them.

        Its positions are (k, 3), its rotations (k, 3, 3).
        """
        turned = [None] * len(times) if rotations is None else rotations
        self.place(name, positions[0], turned[0])
        for t, position, rotation in zip(times, positions, turned, strict=True):
            with self.scene.filming(self.film, float(t - times[0])):
                self.place(name, position, rotation)

    def tint(self, name: str, colour: FloatArray) -> None:
        """Give a mesh another colour: at once, or while the scene is filming, from that frame on."""
        time = self.scene.frame_time
        if time is not None:
            self.film.key(f"{ROOT}/{name}/<object>", "material.color", "color", time, colour)
        else:
            self.root[name].set_property("color", [*map(float, colour), self._opacity[name]])


class _Property:
    """Sets a property; Meshcat's own command writes its name in small letters, which three.js does not."""

    def __init__(self, path: str, name: str, value: Any) -> None:
        self._path, self._name, self._value = path, name, value

    def lower(self) -> dict[str, Any]:
        """The command as Meshcat's page takes it."""
        return {"type": "set_property", "path": self._path, "property": self._name, "value": self._value}


def _shift(by: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix
