"""The HTML page of a scene, with legend, time bar and controls."""

from __future__ import annotations

import base64
import gzip
import html
import json
import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path as File
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Obstacle, Path
from ffsms_pin.viewer.frames import (
    CAMERAS,
    DrawnClient,
    Frames,
    camera_direction,
    middle_and_radius,
    seen_points,
)
from ffsms_pin.viewer.marks import Mark
from ffsms_pin.viewer.meshes import ASSISTANCE_STOPS, AXIS_COLOURS, COLOURS, USAGE_STOPS
from ffsms_pin.viewer.scene import ROOT, Stage


@dataclass(frozen=True)
class Layer:
    """A part of the scene with its label in the legend, its nodes, and its colour in the legend as CSS."""

    label: str
    nodes: tuple[str, ...]
    colour: str


def _layer(label: str, nodes: str, *colours: str) -> Layer:
    """Make a layer from comma-separated names of nodes; several colours make a gradient."""
    swatch = colours[0] if len(colours) == 1 else f"linear-gradient(to right, {', '.join(colours)})"
    return Layer(label, tuple(nodes.split(",")), swatch)


_C = COLOURS
LAYERS = {
    "robot": _layer("satellite and arm", "robot", "#CCC7B8", "#336BA1"),
    "ghosts": _layer("outlines of the arm: start, end", "start,end", _C["start"], _C["end"]),
    "panels": _layer("solar cells (drawn only)", "panels", "#1E3A6E"),
    "target": _layer("target", "target", _C["target"]),
    "path": _layer("path to follow", "path", _C["target"]),
    "obstacles": _layer("obstacles", "obstacles", _C["obstacle"]),
    "client": _layer("client", "client", _C["client"]),
    "actuators": _layer("reaction wheels, thrusters", "wheels,thrusters", _C["wheels"], _C["thrusters"]),
    "planned_path": _layer("planned path, by assistance", "planned path", *ASSISTANCE_STOPS),
    "tracked_path": _layer("trail of the end effector", "tracked path", "var(--ink)"),
    "client_path": _layer("trail of the client", "client path", _C["client"]),
    "frames": _layer("axes: base, end effector, client", "frame base,frame tool,frame client", *AXIS_COLOURS),
    "base_trail": _layer("base frame over time", "base trail", *AXIS_COLOURS),
    "base_motion": _layer("principal base motion", "base motion u1", _C["base_linear"], _C["base_turn"]),
    "principal_motions": _layer("principal end-effector motions", "principal motions", _C["principal"]),
    "direction": _layer("direction to the target", "direction d", "var(--ink)"),
    "cone": _layer("cone of zero cost, by assistance", "cone of the cost", *ASSISTANCE_STOPS),
    "contact": _layer("force at contact", "contact force", _C["contact"]),
    "events": _layer("events, stops in red", "events", _C["event"], _C["stop"]),
    "limits": _layer("joints, by use of their limits", "joint limits", *USAGE_STOPS),
    "clearance": _layer("least clearance", "clearance", *USAGE_STOPS),
}
"""The layers by their names for `show`, in the order of the legend."""

# Layers that are hidden at first.
_OFF = ("ghosts", "frames", "base_trail", "principal_motions", "limits", "clearance")
INK = ("tracked path", "direction d")
"""The nodes that `page.js` draws light on the dark background and dark on the white background."""


def chosen_layers(show: str | Sequence[str] | None) -> set[str]:
    """Return the layers' names for `show`: None for the default layers, "all", a name or several names."""
    if show is None:
        return set(LAYERS) - set(_OFF)
    if isinstance(show, str):
        show = tuple(LAYERS) if show == "all" else (show,)
    for name in show:
        if name not in LAYERS:
            raise InvalidValue("show", name, f"must be 'all' or names of layers: {', '.join(LAYERS)}")
    return set(show)


def staged(
    frames: Frames,
    camera: str,
    client: DrawnClient | None,
    obstacles: Sequence[Obstacle],
    path: Path | None = None,
) -> tuple[Stage, dict[str, Any]]:
    """Return an empty stage around a motion, its path and client, and the data of the cameras.

    `camera` is the first camera. The camera "base" shows the points `seen_riding`, every other camera shows
    the points `seen`.
    """
    fixed, riding = seen_points(frames, client, obstacles, path)
    centre, radius = middle_and_radius(fixed)
    cameras = {
        "camera": camera,
        "centre": centre.tolist(),
        "cameras": {name: camera_direction(name, frames).tolist() for name in CAMERAS},
        "seen": _outermost(fixed - centre),
        "seen_riding": _outermost(riding - centre),
        "base": frames.q[0, :7].tolist(),
    }
    return Stage(centre, radius), cameras


def _outermost(points: FloatArray) -> list[list[float]]:
    """Return the corners of the hull of points (k, 3) [m]."""
    from scipy.spatial import ConvexHull  # slow to load

    # "QJ" joggles the points, because qhull fails for coplanar points.
    corners: FloatArray = points[ConvexHull(points, qhull_options="QJ").vertices]
    return [[round(float(x), 4) for x in corner] for corner in corners]


def facts(
    stage: Stage,
    frames: Frames,
    shown: set[str],
    speed: float,
    play: bool,
    marks: Sequence[Mark],
    **looks: Any,
) -> dict[str, Any]:
    """Return the data that `page.js` reads, and make only the layers in `shown` visible.

    `marks` are the events for the time bar; `looks` are the readings and the data of cameras and background.
    """
    layers, drawn = [], {path.split("/")[2] for path in stage.paths if path.startswith(f"{ROOT}/")}
    for name, layer in LAYERS.items():
        nodes = [node for node in layer.nodes if node in drawn]
        for node in nodes:
            stage.set_property(node, "visible", name in shown)
        if nodes:
            layers.append({"name": name, "shown": name in shown, **asdict(layer)})
    scales = [{"label": "used share of a limit", "stops": list(USAGE_STOPS), "ends": ["0", "1"]}]
    if frames.target is not None:
        ends = ["−1 away", "0 perpendicular", "1 towards"]
        scales.insert(
            0, {"label": "coupling assistance cos θₐ", "stops": list(ASSISTANCE_STOPS), "ends": ends}
        )
    return {
        "t": np.round(frames.t - frames.t[0], 5).tolist(),
        "speed": speed,
        "play": play,
        **looks,
        "layers": layers,
        "scales": scales,
        "ink": list(INK),
        "titles": stage.titles,
        "trails": stage.trails,
        "marks": [
            {
                "t": round(mark.time - float(frames.t[0]), 5),
                "name": mark.name,
                "reason": mark.reason,
                "colour": COLOURS["stop" if mark.stops else "event"],
            }
            for mark in marks
        ],
    }


def readings(
    frames: Frames, aim: str, latched: float | None, path: Path | None = None
) -> list[dict[str, Any]]:
    """Return the readings beside the time bar: labels, units, digits, and values per frame.

    `aim` is the name of the target in the label of the distance. Assistance and distance have no values from
    the time `latched` [s] on. The distance from `path` is left out for the fastest timing before planning has
    added the time law.
    """
    before = np.full(len(frames.t), True) if latched is None else frames.t < latched - 1e-9
    rows: list[tuple[str, str, int, FloatArray, str]] = [("entropy", "", 3, frames.entropy, "")]
    if frames.target is not None:
        distance = 1e3 * np.linalg.norm(frames.target - frames.tips, axis=1)
        rows.append(("assistance", "", 3, np.where(before, frames.assistance, np.nan), "assistance –"))
        rows.append((f"to {aim}", " mm", 1, np.where(before, distance, np.nan), "latched"))
    if path is not None and (path.timing == "given" or path.law is not None):
        steps = zip(frames.t.tolist(), frames.q, frames.tips, strict=True)
        off = [np.linalg.norm(path.place(t).at(q).position - tip) for t, q, tip in steps]
        rows.append(("off the path", " mm", 2, 1e3 * np.array(off), ""))
    if frames.force is not None:
        rows.append(("contact", " N", 2, np.linalg.norm(frames.force, axis=1), ""))
    return [
        {
            "label": label,
            "unit": unit,
            "digits": digits,
            "values": [None if np.isnan(value) else round(float(value), 5) for value in values],
            "without": without,  # text for a frame without a value
        }
        for label, unit, digits, values, without in rows
    ]


def page(title: str, commands: Sequence[bytes], facts: dict[str, Any]) -> str:
    """Return the text of the HTML file, with Meshcat's packed commands and the data for `page.js`."""
    framed = b"".join(struct.pack("<I", len(command)) + command for command in commands)
    # Without a time stamp the same scene gives the same text. Level 9 saves little and is much slower.
    packed = base64.b64encode(gzip.compress(framed, 6, mtime=0)).decode("ascii")
    data = json.dumps(facts, allow_nan=False).replace("<", "\\u003c")  # "</script>" would end the element
    text = (files("ffsms_pin.viewer") / "page.html").read_text("utf-8")
    scripts = (
        f"<script>{_meshcat_script()}</script>"
        f'<script id="facts" type="application/json">{data}</script>'
        f'<script id="commands" type="text/plain">{packed}</script>'
        f"<script>{(files('ffsms_pin.viewer') / 'page.js').read_text('utf-8')}</script>"
    )
    return text.replace("%%TITLE%%", html.escape(title)).replace("%%SCRIPTS%%", scripts)


def _meshcat_script() -> str:
    """Return the script of Meshcat's page, without importing Meshcat, which loads IPython and ZeroMQ."""
    package = find_spec("meshcat")
    assert package is not None  # the import of `ffsms_pin.viewer` requires Meshcat
    assert package.origin is not None
    return (File(package.origin).parent / "viewer" / "dist" / "main.min.js").read_bytes().decode()
