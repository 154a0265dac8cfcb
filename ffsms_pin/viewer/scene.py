"""A scene as commands for Meshcat's page, with key frames for its animation.

Only the page of the package `meshcat` is used; the commands are generated here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack

from ffsms_pin.checks import FloatArray
from ffsms_pin.viewer.meshes import Mesh, packed, rgb

ROOT = "/ffsms"
_GONE = 1e-6  # scale of a hidden object, because a scale of zero has no inverse


class KeyFrames:
    """The key frames of an animation, by node and property in three.js.

    `time` [s] is the time of the recorded frame, or None if no frame is being recorded.
    """

    def __init__(self) -> None:
        self.time: float | None = None
        self._tracks: dict[tuple[str, str, str], tuple[list[float], list[FloatArray]]] = {}

    def add(self, path: str, name: str, kind: str, value: FloatArray) -> None:
        """Add a key frame of a node's property `name`, such as "position"; `kind` is its type in three.js."""
        assert self.time is not None
        times, values = self._tracks.setdefault((path, name, kind), ([], []))
        times.append(self.time)
        values.append(np.array(value))

    def animations(self) -> list[dict[str, Any]]:
        """Return the animations for Meshcat's `set_animation`, one clip per node."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for (path, name, kind), (times, values) in self._tracks.items():
            at, rows = np.array(times, dtype=np.float32), np.array(values, dtype=np.float32)
            if np.ptp(rows, axis=0).max() <= 1e-7:  # a constant needs two keys
                at, rows = at[[0, -1]], rows[[0, -1]]
            clips.setdefault(path, []).append(
                {"name": f".{name}", "type": kind, "times": packed(at), "values": packed(rows)}
            )
        return [
            {"path": path, "clip": {"fps": 1, "name": "default", "tracks": tracks}}
            for path, tracks in clips.items()
        ]


class Stage:
    """A scene whose camera turns about a centre (3,) [m].

    `size` [m], half the diagonal of the box around the scene, sets the size of arrows and markers. While
    `key_frames.time` is not None, motions and colours of nodes are recorded as key frames.
    """

    def __init__(self, centre: FloatArray, size: float) -> None:
        self.key_frames, self.size = KeyFrames(), size
        # The keys are type, path and property: a command replaces an earlier command with the same key.
        self._commands: dict[tuple[str, str, str], bytes] = {}
        self._opacity: dict[str, float] = {}
        self.titles: dict[str, str] = {}  # names of nodes, shown under the pointer
        self.trails: list[dict[str, Any]] = []  # tubes that are drawn up to the current time
        self.place(ROOT, -centre)  # the centre is at the origin, about which the camera turns
        for name in ("/Grid", "/Axes"):
            self.set_property(name, "visible", False)

    @property
    def commands(self) -> list[bytes]:
        """The packed commands in their order."""
        return list(self._commands.values())

    @property
    def paths(self) -> list[str]:
        """The paths of all nodes."""
        return list(dict.fromkeys(path for _, path, _ in self._commands))

    def play(self) -> None:
        """End the recording of key frames, and make the page play them in a loop."""
        self.key_frames.time = None
        options = {"play": True, "repetitions": 1_000_000}
        self._send("set_animation", "", animations=self.key_frames.animations(), options=options)

    def _send(self, kind: str, path: str, **values: Any) -> None:
        key = kind, path, values.get("property", "")
        self._commands.pop(key, None)  # so that the new command is inserted last
        self._commands[key] = bytes(umsgpack.packb({"type": kind, "path": path, **values}))

    def draw(
        self,
        name: str,
        shape: Mesh | dict[str, Any],
        colour: str | FloatArray,
        opacity: float = 1.0,
        flat: bool = False,
        through: bool = False,
    ) -> None:
        """Draw a shape in one colour (3,) or "#RRGGBB", or in one colour per vertex (k, 3).

        The shape is a mesh, or a dict with a geometry of three.js or a mesh file. `flat` disables shading.
        With `through`, the shape is visible through objects in front of it.
        """
        colours = rgb(colour) if isinstance(colour, str) else colour
        plain = colours.ndim == 1
        geometry = shape.geometry(None if plain else colours) if isinstance(shape, Mesh) else shape
        self._opacity[name] = opacity
        material = {
            "uuid": f"{name} material",
            "type": "MeshBasicMaterial" if flat else "MeshPhongMaterial",
            "color": _packed_colour(colours) if plain else 0xFFFFFF,
            "reflectivity": 0.5,
            "side": 2,  # draw both sides of faces
            "opacity": opacity,
            "transparent": opacity < 1.0 or through,  # transparent objects are drawn last
            "vertexColors": 0 if plain else 2,
            "depthWrite": opacity == 1.0 and not through,
            "depthTest": not through,
        }
        thing = {"type": "Mesh", "geometry": f"{name} geometry", "material": f"{name} material"}
        self._object(name, thing, [{"uuid": f"{name} geometry", **geometry}], [material])
        if through:  # drawn after all other objects, so that no transparent object tints it
            self.set_property(f"{name}/<object>", "renderOrder", 1)

    def outline(self, name: str, shape: Mesh, larger: Mesh, colour: str) -> None:
        """Draw the silhouette of a shape as a line, where the shape `larger` extends beyond it.

        The shape itself is drawn invisibly and hides the inner part of `larger`. Both are drawn after all
        other objects, so they hide no other object.
        """
        common = {"type": "MeshBasicMaterial", "transparent": True}
        parts = (
            ("shape", shape, {**common, "colorWrite": False, "side": 2}),
            ("line", larger, {**common, "color": _packed_colour(rgb(colour)), "side": 1}),  # back faces
        )
        for order, (part, mesh, material) in enumerate(parts, start=2):
            node = f"{name}/{part}"
            thing = {"type": "Mesh", "geometry": f"{node} geometry", "material": f"{node} material"}
            geometry = {"uuid": f"{node} geometry", **mesh.geometry(None)}
            self._object(node, thing, [geometry], [{"uuid": f"{node} material", **material}])
            self.set_property(f"{node}/<object>", "renderOrder", order)

    def collada(self, name: str, text: str, resources: dict[str, str]) -> None:
        """Draw a COLLADA file in its own colours; `resources` are its textures as data URLs by name."""
        thing = {"type": "_meshfile_object", "format": "dae", "data": text, "resources": resources}
        self._object(name, thing, [], [])

    def _object(self, name: str, thing: Any, geometries: list[Any], materials: list[Any]) -> None:
        thing |= {"uuid": name, "matrix": np.eye(4).ravel().tolist()}
        whole = {"metadata": {"version": 4.5, "type": "Object"}, "object": thing}
        whole |= {"geometries": geometries, "materials": materials}
        self._send("set_object", self._path(name), object=whole)

    def place(
        self, name: str, position: FloatArray, rotation: FloatArray | None = None, scale: Any = 1.0
    ) -> None:
        """Move a node or, while key frames are recorded, add its pose and scale as key frames."""
        size = np.broadcast_to(np.asarray(scale, dtype=np.float64), (3,))
        size = np.where(np.abs(size) < _GONE, _GONE, size)
        turn, path, keys = np.eye(3) if rotation is None else rotation, self._path(name), self.key_frames
        if keys.time is None:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = turn * size, position
            self._send("set_transform", path, matrix=matrix.T.ravel().tolist())
            return
        keys.add(path, "position", "vector3", position)
        keys.add(path, "quaternion", "quaternion", pin.Quaternion(turn).coeffs())
        keys.add(path, "scale", "vector3", size)

    def set_property(self, name: str, property: str, value: Any) -> None:
        """Set a three.js property of a node; a name that begins with "/" is an absolute path."""
        self._send("set_property", self._path(name), property=property, value=value)

    @staticmethod
    def _path(name: str) -> str:
        return name if name.startswith("/") else f"{ROOT}/{name}"

    def tint(self, name: str, colour: FloatArray) -> None:
        """Change a mesh's colour or, while key frames are recorded, add the colour as a key frame."""
        if self.key_frames.time is None:
            self.set_property(name, "color", [*colour.tolist(), self._opacity[name]])
        else:
            self.key_frames.add(self._path(f"{name}/<object>"), "material.color", "color", colour)


def _packed_colour(colour: FloatArray) -> int:
    """Return a colour (3,) as the number 0xRRGGBB."""
    return int.from_bytes((255.0 * colour).round().astype(np.uint8).tobytes())
