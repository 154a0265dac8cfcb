"""A scene as Meshcat's page takes it, with key frames for its film, and the stage on which layers draw.

Commands are written here; of Meshcat's package only the page is used.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ViewerError
from ffsms_pin.viewer.meshes import Mesh, array_of, floats, sphere

ROOT = "/ffsms"
_GONE = 1e-6  # as small as a thing gets that is not there: a scale of zero has no inverse
_STILL = 1e-7
# What draws and moves things. Meshcat's page knows more commands, and one of them (`set_control`) evaluates
# a text that comes with it: none of those ever leaves this process.
_KINDS = ("set_object", "set_transform", "set_property", "set_animation", "delete")


class Film:
    """Tracks of key frames, by the path of the node and the name of its property in three.js."""

    def __init__(self) -> None:
        self._tracks: dict[tuple[str, str, str], tuple[list[float], list[FloatArray]]] = {}

    def key(self, path: str, name: str, kind: str, time: float, value: ArrayLike) -> None:
        """Add a key frame of a node's property, such as "position", at a time [s] that grows.

        The kind of track is three.js': "vector3", "quaternion", "color", "number".
        """
        times, values = self._tracks.setdefault((path, name, kind), ([], []))
        times.append(time)
        values.append(np.atleast_1d(np.asarray(value, dtype=np.float64)))

    def place(self, path: str, time: float, matrix: FloatArray) -> None:
        """Add key frames of position, attitude and size from a matrix (4, 4)."""
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            scale[0] = -scale[0]
        self.key(path, "position", "vector3", time, matrix[:3, 3].copy())
        self.key(path, "quaternion", "quaternion", time, pin.Quaternion(matrix[:3, :3] / scale).coeffs())
        self.key(path, "scale", "vector3", time, scale)

    def command(self, speed: float) -> bytes:
        """The packed command that plays it over and over, `speed` times as fast: one clip a node."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for (path, name, kind), (times, values) in self._tracks.items():
            at, rows = np.array(times) / speed, np.array(values)
            if np.ptp(rows, axis=0).max() <= _STILL:  # two keys say that nothing happens
                at, rows = at[[0, -1]], rows[[0, -1]]
            clips.setdefault(path, []).append(
                {"name": f".{name}", "type": kind, "times": floats(at), "values": floats(rows.ravel())}
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
    bounded by the scene, not by the length of a run. While `filming`, transforms become key frames instead.

    Attributes
    ----------
    film : Film
    frame_time : float or None
        [s] of the frame that is being filmed.
    """

    def __init__(self) -> None:
        self.film = Film()
        self.frame_time: float | None = None
        self._lock = threading.Lock()
        self._count = 0
        # By kind, path and property: the command's number and the packed command. A dict keeps its order;
        # a command that replaces another one goes to the end.
        self._latest: dict[tuple[str, str, str], tuple[int, bytes]] = {}

    def send(self, kind: str, path: str, **values: Any) -> None:
        """Take a command on a node."""
        command = umsgpack.packb({"type": kind, "path": path, **values})
        self.put(kind, path, values.get("property", ""), command)

    def transform(self, path: str, matrix: FloatArray) -> None:
        """Move a node to a pose and size (4, 4), or add that to the film."""
        if self.frame_time is not None:
            self.film.place(path, self.frame_time, matrix)
        else:
            self.send("set_transform", path, matrix=matrix.T.ravel().tolist())

    @contextmanager
    def filming(self, time: float) -> Iterator[None]:
        """Inside the block, transforms are key frames at `time` [s]."""
        self.frame_time = time
        try:
            yield
        finally:
            self.frame_time = None

    def put(self, kind: str, path: str, name: str, packed: bytes) -> None:
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
            self._latest[kind, path, name] = (self._count, packed)

    def since(self, count: int) -> tuple[int, list[bytes]]:
        """The number of commands so far, and those after the first `count`, in order.

        Those that later ones replaced are left out.
        """
        found: list[bytes] = []
        with self._lock:
            for number, packed in reversed(self._latest.values()):
                if number <= count:
                    break
                found.append(packed)
            return self._count, found[::-1]

    @property
    def paths(self) -> list[str]:
        """Paths of everything that the scene holds."""
        return list(dict.fromkeys(path for _, path, _ in self._latest))

    def commands(self) -> list[bytes]:
        """Packed commands that build the scene, in order, without those that play its film."""
        return [packed for (kind, *_), (_, packed) in self._latest.items() if kind != "set_animation"]

    def _drop(self, keys: list[tuple[str, str, str]]) -> None:
        for key in keys:
            self._latest.pop(key, None)


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

    @property
    def nodes(self) -> list[str]:
        """Names of the nodes at the top of what is drawn."""
        below = [path.split("/") for path in self.scene.paths if path.startswith(f"{ROOT}/")]
        return list(dict.fromkeys(names[2] for names in below))

    def set_up(self, centre: FloatArray, camera: FloatArray) -> None:
        """Background, and a camera at `camera` (3,) from a centre (3,) that it looks at [m]."""
        shift = np.eye(4)
        shift[:3, 3] = -centre  # the page's camera turns about the origin
        self.scene.transform(ROOT, shift)
        self.tell("/Background", "top_color", [1.0, 1.0, 1.0])
        self.tell("/Background", "bottom_color", [0.86, 0.90, 0.94])
        for name in ("/Grid", "/Axes"):
            self.tell(name, "visible", False)
        x, y, z = camera.tolist()
        self.tell("/Cameras/default/rotated/<object>", "position", [x, z, -y])  # there y is up

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
        attributes = {"position": array_of(mesh.vertices, np.float32)}
        if not isinstance(colour, str):
            attributes["color"] = array_of(colour, np.float32)
        data = {"attributes": attributes, "index": array_of(mesh.faces, np.uint32)}
        self.shape(name, {"type": "BufferGeometry", "data": data}, colour, opacity, flat, through)

    def ball(self, name: str, radius: float, colour: str, opacity: float = 1.0) -> None:
        """Draw a ball about the node's origin, without light and shade, seen through what is before it."""
        self.shape(name, sphere(radius), colour, opacity, flat=True, through=True)

    def shape(
        self,
        name: str,
        geometry: dict[str, Any],
        colour: str | FloatArray,
        opacity: float = 1.0,
        flat: bool = False,
        through: bool = False,
    ) -> None:
        """Draw a geometry of three.js, or a mesh file, as `mesh` does."""
        self._opacity[name], plain = opacity, isinstance(colour, str)
        material = {
            "uuid": f"{name} material",
            "type": "MeshBasicMaterial" if flat else "MeshPhongMaterial",
            "color": int(colour[1:], 16) if isinstance(colour, str) else 0xFFFFFF,
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
        self.scene.send("set_object", f"{ROOT}/{name}", object=whole)

    def place(
        self, name: str, position: FloatArray, rotation: FloatArray | None = None, scale: Any = 1.0
    ) -> None:
        """Move a node: at once, or while the scene is filming, in that frame."""
        matrix = np.eye(4)
        size = np.broadcast_to(np.asarray(scale, dtype=np.float64), (3,))
        size = np.where(np.abs(size) < _GONE, _GONE, size)
        matrix[:3, :3] = (np.eye(3) if rotation is None else rotation) * size
        matrix[:3, 3] = position
        self.scene.transform(f"{ROOT}/{name}", matrix)

    def tell(self, name: str, property: str, value: Any) -> None:
        """Set a property of a node, in three.js' spelling; a name with "/" before it counts from the top."""
        path = name if name.startswith("/") else f"{ROOT}/{name}"
        self.scene.send("set_property", path, property=property, value=value)

    def tint(self, name: str, colour: FloatArray) -> None:
        """Give a mesh another colour: at once, or while the scene is filming, from that frame on."""
        time = self.scene.frame_time
        if time is not None:
            self.scene.film.key(f"{ROOT}/{name}/<object>", "material.color", "color", time, colour)
        else:
            self.tell(name, "color", [*colour.tolist(), self._opacity[name]])
