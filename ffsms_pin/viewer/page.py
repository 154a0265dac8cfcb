"""The page of a scene, with legend, time bar and speed: one file with everything in it, or a live one."""

from __future__ import annotations

import base64
import gzip
import html
import json
import struct
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.errors import InvalidValue
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import ASSISTANCE_STOPS, AXIS_COLOURS, COLOURS, USAGE_STOPS
from ffsms_pin.viewer.scene import Stage


@dataclass(frozen=True)
class Layer:
    """A part of the scene: its label in the legend, its nodes, and the colour of its swatch as CSS."""

    label: str
    nodes: tuple[str, ...]
    colour: str


def _gradient(*stops: str) -> str:
    return f"linear-gradient(to right, {', '.join(stops)})"


LAYERS = {
    "robot": Layer("satellite and arm", ("robot",), _gradient("#CCC7B8", "#336BA1")),
    "ghosts": Layer(
        "pale: at the start, at the end", ("start", "end"), _gradient(COLOURS["start"], COLOURS["end"])
    ),
    "target": Layer("target", ("target",), COLOURS["target"]),
    "obstacles": Layer("obstacles", ("obstacles",), COLOURS["obstacle"]),
    "client": Layer("client", ("client",), COLOURS["client"]),
    "actuators": Layer(
        "reaction wheels, thrusters",
        ("wheels", "thrusters"),
        _gradient(COLOURS["wheel"], COLOURS["thruster"]),
    ),
    "planned_path": Layer("planned path, by cos θₐ", ("planned path",), _gradient(*ASSISTANCE_STOPS)),
    "tracked_path": Layer("tracked path", ("tracked path",), COLOURS["tracked"]),
    "base_trail": Layer("base frame over time", ("base trail",), _gradient(*AXIS_COLOURS)),
    "base_motion": Layer(
        "σ₁u₁: base motion, shift and turn",
        ("base motion u1",),
        _gradient(COLOURS["base_linear"], COLOURS["base_turn"]),
    ),
    "principal_motions": Layer(
        "J*v₁, J*v₂, … (paler): end effector", ("principal motions",), COLOURS["principal"]
    ),
    "direction": Layer("d: towards the target", ("direction d",), COLOURS["direction"]),
    "cone": Layer("cone of the cost, by cos θₐ", ("cone of the cost",), _gradient(*ASSISTANCE_STOPS)),
    "contact": Layer("force at contact", ("contact force",), COLOURS["contact"]),
    "limits": Layer("joints, by use of their limits", ("joint limits",), _gradient(*USAGE_STOPS)),
    "clearance": Layer("least clearance", ("clearance",), _gradient(*USAGE_STOPS)),
}
"""Every layer by the name that `show` takes, in the order of the legend."""

_OFF = ("base_trail", "principal_motions", "limits", "clearance")  # unless it is said otherwise


def chosen_layers(show: str | Sequence[str] | None) -> set[str]:
    """The layers that `show` names: None for the default ones, "all", one name, or several."""
    if show is None:
        return set(LAYERS) - set(_OFF)
    if isinstance(show, str):
        show = tuple(LAYERS) if show == "all" else (show,)
    instance("show", show, Iterable)
    chosen = list(show)
    for name in chosen:
        if not isinstance(name, str) or name not in LAYERS:
            raise InvalidValue("show", name, f"knows 'all', {', '.join(LAYERS)}")
    return set(chosen)


def visible_layers(stage: Stage, shown: set[str]) -> dict[str, bool]:
    """Make the layers that a scene has visible, or not; by name."""
    found: dict[str, bool] = {}
    there = stage.nodes
    for name, layer in LAYERS.items():
        for node in layer.nodes:
            if node in there:
                found[name] = name in shown
                stage.tell(node, "visible", name in shown)
    return found


def facts(
    frames: Frames, shown: dict[str, bool], speed: float | None, play: bool, seen: dict[str, Any]
) -> dict[str, Any]:
    """The facts that `page.js` reads: `shown` says which layers are visible at first, `seen` from where."""
    scales = [{"label": "use of a limit", "stops": list(USAGE_STOPS), "ends": ["0", "all of it"]}]
    if frames.target is not None:
        ends = ["−1 away", "0 across", "1 at it"]
        scales.insert(0, {"label": "assistance cos θₐ", "stops": list(ASSISTANCE_STOPS), "ends": ends})
    layers = [{"name": name, "shown": on, **asdict(LAYERS[name])} for name, on in shown.items()]
    return {
        "t": _short(frames.t - frames.t[0]),
        "speed": speed,
        "play": play,
        **seen,
        "layers": layers,
        "scales": scales,
        "readings": readings(frames),
    }


def readings(frames: Frames) -> list[dict[str, Any]]:
    """What the page says beside the time bar: labels, units, digits, and values, one a frame."""
    found = [("entropy", "", 3, frames.entropy)]
    if frames.target is not None:
        distance = 1e3 * np.linalg.norm(frames.target - frames.tips, axis=1)
        found += [("cos θₐ", "", 3, frames.assistance), ("to target", " mm", 1, distance)]
    if frames.force is not None:
        found.append(("contact", " N", 2, np.linalg.norm(frames.force, axis=1)))
    return [
        {"label": label, "unit": unit, "digits": digits, "values": _short(values)}
        for label, unit, digits, values in found
    ]


def _short(values: FloatArray) -> list[float]:
    """Numbers as they are read, not as they are computed."""
    return [round(float(value), 4) for value in values]


def page(title: str, commands: Sequence[bytes], facts: dict[str, Any]) -> str:
    """The text of the file, with Meshcat's packed commands in order, and what legend and read-out show."""
    framed = b"".join(struct.pack("<I", len(command)) + command for command in commands)
    # Without a time in the archive, the same scene gives the same text.
    packed = base64.b64encode(gzip.compress(framed, mtime=0)).decode("ascii")
    meshcat, own = (script.decode() for script in scripts().values())
    carried = f'<script id="commands" type="text/plain">{packed}</script>'
    return _page(title, f"<script>{meshcat}</script>{_data(facts)}{carried}<script>{own}</script>")


def live_page(title: str, facts: dict[str, Any]) -> str:
    """The page whose scene comes through a socket, and whose scripts come from the same server."""
    meshcat, own = (f'<script src="{name}"></script>' for name in scripts())
    return _page(title, meshcat + _data(facts) + own)


def scripts() -> dict[str, bytes]:
    """Meshcat's script and ours by their names, in the order in which a page needs them."""
    found = find_spec("meshcat")  # the package is not imported: it loads IPython and ZeroMQ
    assert found is not None  # or the viewer would not have been imported
    assert found.origin is not None
    meshcat = Path(found.origin).parent
    return {
        "main.min.js": (meshcat / "viewer" / "dist" / "main.min.js").read_bytes(),
        "page.js": (files("ffsms_pin.viewer") / "page.js").read_bytes(),
    }


def _data(facts: dict[str, Any]) -> str:
    # Nothing in it may end the element that it stands in.
    text = json.dumps(facts, allow_nan=False).replace("<", "\\u003c")
    return f'<script id="facts" type="application/json">{text}</script>'


def _page(title: str, scripts: str) -> str:
    text = (files("ffsms_pin.viewer") / "page.html").read_text("utf-8")
    return text.replace("%%TITLE%%", html.escape(title)).replace("%%SCRIPTS%%", scripts)
