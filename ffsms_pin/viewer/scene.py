"""A scene as Meshcat's page takes it, with key frames for its film, and the stage on which layers draw.

Commands are written here; of Meshcat's package only the page is used.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ViewerError
from ffsms_pin.viewer.meshes import Mesh, packed, rgb

ROOT = "/ffsms"
_GONE = 1e-6  # as small as a thing gets that is not there: a scale of zero has no inverse
# What draws and moves things. Meshcat's page knows more commands, and one of them (`set_control`) evaluates
# a text that comes with it: none of those ever leaves this process.
_KINDS = ("set_object", "set_transform", "set_property", "set_animation", "delete")


class Film:
    """Tracks of key frames, by the path of the node and the name of its property in three.js.

    `time` [s] is that of the frame that is being filmed: while it is a number, what moves becomes key frames.
    """

    def __init__(self) -> None:
        self.time: float | None = None
        self._tracks: dict[tuple[str, str, str], tuple[list[float], list[FloatArray]]] = {}

    def key(self, path: str, name: str, kind: str, value: FloatArray) -> None:
        """Add a key frame of a node's property, such as "position", of a kind as three.js names it."""
        assert self.time is not None
        times, values = self._tracks.setdefault((path, name, kind), ([], []))
        times.append(self.time)
        values.append(np.array(value))

    def command(self) -> bytes:
        """The packed command that plays it over and over: one clip a node."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for (path, name, kind), (times, values) in self._tracks.items():
            at, rows = np.array(times, dtype=np.float32), np.array(values, dtype=np.float32)
            if np.ptp(rows, axis=0).max() <= 1e-7:  # two keys say that nothing happens
                at, rows = at[[0, -1]], rows[[0, -1]]
            clips.setdefault(path, []).append(
                {"name": f".{name}", "type": kind, "times": packed(at), "values": packed(rows)}
            )
        animations = [
            {"path": path, "clip": {"fps": 1, "name": "default", "tracks": tracks}}
            for path, tracks in clips.items()
        ]
        options = {"play": True, "repetitions": 1_000_000}
        data = {"type": "set_animation", "path": "", "animations": animations, "options": options}
        return bytes(umsgpack.packb(data))


class Scene:
    """The commands that make a scene; the thread of a live page reads them.

    A page that is too slow for every command skips those that later ones have replaced, so what is kept is
    bounded by the scene, not by the length of a run. What moves in its `film` is kept there.
    """

    def __init__(self) -> None:
        self.film = Film()
        self._lock = threading.Lock()
        self._count = 0
        # By kind, path and property: the command's number and the packed command. A dict keeps its order;
        # a command that replaces another one goes to the end.
        self._latest: dict[tuple[str, str, str], tuple[int, bytes]] = {}

    def send(self, kind: str, path: str, **values: Any) -> None:
        """Take a command on a node."""
        command = umsgpack.packb({"type": kind, "path": path, **values})
        self.put(kind, path, values.get("property", ""), command)

    def put(self, kind: str, path: str, name: str, command: bytes) -> None:
        """Take a packed command on a node; `name` is that of the property, where it sets one, or empty.

        Raises
        ------
        ViewerError
            A kind of command that no page is sent.
        """
        if kind not in _KINDS:
            raise ViewerError(f"the live page is not sent commands of the kind '{kind}'; use {_KINDS}")
        with self._lock:
            if kind == "delete":
                below = path.rstrip("/") + "/"
                self._drop([key for key in self._latest if (key[1] + "/").startswith(below)])
            elif kind == "set_object":  # a new object has its properties still to come
                self._drop([key for key in self._latest if key[:2] == ("set_property", path)])
            self._count += 1
            self._drop([(kind, path, name)])
            self._latest[kind, path, name] = (self._count, command)

    def since(self, count: int) -> tuple[int, list[bytes]]:
        """The number of commands so far, and those after the first `count`, in order.

        Those that later ones replaced are left out.
        """
        found: list[bytes] = []
        with self._lock:
            for number, command in reversed(self._latest.values()):
                if number <= count:
                    break
                found.append(command)
            return self._count, found[::-1]

    @property
    def paths(self) -> list[str]:
        """Paths of everything that the scene holds."""
        return list(dict.fromkeys(path for _, path, _ in self._latest))

    def _drop(self, keys: list[tuple[str, str, str]]) -> None:
        for key in keys:
            self._latest.pop(key, None)


class Stage:
    """A scene about a centre (3,), which the page's camera, at `camera` (3,) from it, looks at [m].

    `size` is about how large the robot is [m]; arrows and markers are shares of it.
    """

    def __init__(self, centre: FloatArray, size: float, camera: FloatArray) -> None:
        self.scene, self.size = Scene(), size
        self._opacity: dict[str, float] = {}
        self.place(ROOT, -centre)  # the camera turns about the origin
        self.tell("/Background", "top_color", [1.0, 1.0, 1.0])
        self.tell("/Background", "bottom_color", [0.86, 0.90, 0.94])
        for name in ("/Grid", "/Axes"):
            self.tell(name, "visible", False)
        x, y, z = camera.tolist()
        self.tell("/Cameras/default/rotated/<object>", "position", [x, z, -y])  # there y is up

    def draw(
        self,
        name: str,
        shape: Mesh | dict[str, Any],
        colour: str | FloatArray,
        opacity: float = 1.0,
        flat: bool = False,
        through: bool = False,
    ) -> None:
        """Draw a mesh, in one colour (3,) or one a vertex (k, 3), or a geometry of three.js or a mesh file.

        `flat` leaves out light and shade; what is drawn `through` is seen through whatever is before it.
        """
        one = rgb(colour) if isinstance(colour, str) else colour
        plain = one.ndim == 1
        geometry = shape.geometry(None if plain else one) if isinstance(shape, Mesh) else shape
        self._opacity[name] = opacity
        material = {
            "uuid": f"{name} material",
            "type": "MeshBasicMaterial" if flat else "MeshPhongMaterial",
            "color": int.from_bytes((255.0 * one).round().astype(np.uint8).tobytes()) if plain else 0xFFFFFF,
            "reflectivity": 0.5,
            "side": 2,  # of faces: both
            "opacity": opacity,
            "transparent": opacity < 1.0 or through,  # what is transparent is drawn last
            "vertexColors": 0 if plain else 2,
            "depthWrite": opacity == 1.0 and not through,
            "depthTest": not through,
        }
        thing = {"type": "Mesh", "geometry": f"{name} geometry", "material": f"{name} material"}
        self._object(name, thing, [{"uuid": f"{name} geometry", **geometry}], [material])
        if through:  # after all others, so that none that is transparent tints it
            self.tell(f"{name}/<object>", "renderOrder", 1)

    def collada(self, name: str, text: str, resources: dict[str, str]) -> None:
        """Draw a COLLADA file in its own colours; its textures are data addresses by their names."""
        thing = {"type": "_meshfile_object", "format": "dae", "data": text, "resources": resources}
        self._object(name, thing, [], [])

    def _object(self, name: str, thing: Any, geometries: list[Any], materials: list[Any]) -> None:
        thing |= {"uuid": name, "matrix": np.eye(4).ravel().tolist()}
        whole = {"metadata": {"version": 4.5, "type": "Object"}, "object": thing}
        whole |= {"geometries": geometries, "materials": materials}
        self.scene.send("set_object", self._path(name), object=whole)

    def place(
        self, name: str, position: FloatArray, rotation: FloatArray | None = None, scale: Any = 1.0
    ) -> None:
        """Move a node: at once, or while the scene is filming, in that frame."""
        size = np.broadcast_to(np.asarray(scale, dtype=np.float64), (3,))
        size = np.where(np.abs(size) < _GONE, _GONE, size)
        turn, path, film = np.eye(3) if rotation is None else rotation, self._path(name), self.scene.film
        if film.time is None:
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = turn * size, position
            self.scene.send("set_transform", path, matrix=matrix.T.ravel().tolist())
            return
        film.key(path, "position", "vector3", position)
        film.key(path, "quaternion", "quaternion", pin.Quaternion(turn).coeffs())
        film.key(path, "scale", "vector3", size)

    def tell(self, name: str, property: str, value: Any) -> None:
        """Set a property of a node, in three.js' spelling; a name with "/" before it counts from the top."""
        self.scene.send("set_property", self._path(name), property=property, value=value)

    @staticmethod
    def _path(name: str) -> str:
        return name if name.startswith("/") else f"{ROOT}/{name}"

    def tint(self, name: str, colour: FloatArray) -> None:
        """Give a mesh another colour: at once, or while the scene is filming, from that frame on."""
        if self.scene.film.time is None:
            self.tell(name, "color", [*colour.tolist(), self._opacity[name]])
        else:
            self.scene.film.key(self._path(f"{name}/<object>"), "material.color", "color", colour)
