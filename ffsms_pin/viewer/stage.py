"""Where layers draw: a scene, the film that moves it, and how large things are."""

from __future__ import annotations

from typing import Any

import meshcat.geometry as mg
import numpy as np
from meshcat.visualizer import Visualizer

from ffsms_pin.checks import FloatArray
from ffsms_pin.viewer.meshes import Mesh
from ffsms_pin.viewer.scene import Scene

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
        self.size = size
        self._opacity: dict[str, float] = {}
        # Meshcat asks for a window to a running server; the scene takes its place.
        self.root = Visualizer(window=self.scene)[ROOT]

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes at the top of what is drawn."""
        below = [path.split("/") for path in self.scene.paths if path.startswith(f"{ROOT}/")]
        return list(dict.fromkeys(names[2] for names in below))

    def set_up(self, centre: FloatArray, camera: FloatArray) -> None:
        """Background, and a camera at `camera` (3,) from a centre (3,) that it looks at [m]."""
        shift = np.eye(4)
        shift[:3, 3] = -centre  # the page's camera turns about the origin
        self.root.set_transform(shift)
        self.root["/Background"].set_property("top_color", [1.0, 1.0, 1.0])
        self.root["/Background"].set_property("bottom_color", [0.86, 0.90, 0.94])
        for name in ("/Grid", "/Axes"):
            self.root[name].set_property("visible", False)
        x, y, z = camera.tolist()
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
        """Draw a mesh in one colour, or in one a vertex (k, 3).

        `flat` leaves out light and shade; what is drawn `through` is seen through whatever is before it.
        """
        each = None if isinstance(colour, str) else colour
        shape = mg.TriangularMeshGeometry(mesh.vertices, mesh.faces, each)
        kind = mg.MeshBasicMaterial if flat else mg.MeshPhongMaterial
        self._draw(name, shape, kind, colour, opacity, through)

    def ball(self, name: str, radius: float, colour: str, opacity: float = 1.0) -> None:
        """Draw a ball about the node's origin, without light and shade, seen through what is before it."""
        self._draw(name, mg.Sphere(radius), mg.MeshBasicMaterial, colour, opacity, through=True)

    def _draw(
        self, name: str, shape: Any, kind: Any, colour: str | FloatArray, opacity: float, through: bool
    ) -> None:
        self._opacity[name] = opacity
        material = kind(
            color=int(colour[1:], 16) if isinstance(colour, str) else 0xFFFFFF,
            opacity=opacity,
            transparent=opacity < 1.0 or through,  # what is transparent is drawn last
            vertexColors=not isinstance(colour, str),
            depthWrite=opacity == 1.0 and not through,
            depthTest=not through,
        )
        self.root[name].set_object(shape, material)
        if through:  # after all others, so that none that is transparent tints it
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
            with self.scene.filming(float(t - times[0])):
                self.place(name, position, rotation)

    def tint(self, name: str, colour: FloatArray) -> None:
        """Give a mesh another colour: at once, or while the scene is filming, from that frame on."""
        time = self.scene.frame_time
        if time is not None:
            self.scene.film.key(f"{ROOT}/{name}/<object>", "material.color", "color", time, colour)
        else:
            self.root[name].set_property("color", [*colour.tolist(), self._opacity[name]])


class _Property:
    """Sets a property; Meshcat's own command writes its name in small letters, which three.js does not."""

    def __init__(self, path: str, name: str, value: Any) -> None:
        self._path, self._name, self._value = path, name, value

    def lower(self) -> dict[str, Any]:
        """The command as Meshcat's page takes it."""
        return {"type": "set_property", "path": self._path, "property": self._name, "value": self._value}
