"""What can be switched on and off in a scene, and how the legend names it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ffsms_pin.errors import InvalidValue
from ffsms_pin.viewer.colours import ASSISTANCE_STOPS, COLOURS, USAGE_STOPS

__all__ = ["DEFAULT", "LAYERS", "Layer", "chosen_layers"]


@dataclass(frozen=True)
class Layer:
    """A part of the scene.

    Attributes
    ----------
    label : str
        In the legend.
    nodes : tuple of str
        Of the scene tree.
    colour : str
        Of the legend's swatch, as CSS.
    """

    label: str
    nodes: tuple[str, ...]
    colour: str


def _gradient(stops: Sequence[str]) -> str:
    return f"linear-gradient(to right, {', '.join(stops)})"


LAYERS = {
    "robot": Layer("satellite and arm", ("robot",), "linear-gradient(to right, #CCC7B8, #336BA1)"),
    "ghosts": Layer(
        "pale: at the start, at the end",
        ("start", "end"),
        f"linear-gradient(to right, {COLOURS['start']}, {COLOURS['end']})",
    ),
    "target": Layer("target", ("target",), COLOURS["target"]),
    "obstacles": Layer("obstacles", ("obstacles",), COLOURS["obstacle"]),
    "client": Layer("client", ("client",), COLOURS["client"]),
    "actuators": Layer(
        "reaction wheels, thrusters",
        ("wheels", "thrusters"),
        f"linear-gradient(to right, {COLOURS['wheel']}, {COLOURS['thruster']})",
    ),
    "planned_path": Layer("planned path, by cos θₐ", ("planned path",), _gradient(ASSISTANCE_STOPS)),
    "tracked_path": Layer("tracked path", ("tracked path",), COLOURS["tracked"]),
    "base_trail": Layer(
        "base frame over time", ("base trail",), "linear-gradient(to right, #D55E00, #009E73, #0072B2)"
    ),
    "base_motion": Layer(
        "σ₁u₁: base motion, shift and turn",
        ("base motion u1",),
        f"linear-gradient(to right, {COLOURS['base_linear']}, {COLOURS['base_turn']})",
    ),
    "principal_motions": Layer(
        "J*v₁, J*v₂, … (paler): end effector", ("principal motions",), COLOURS["principal"]
    ),
    "direction": Layer("d: towards the target", ("direction d",), COLOURS["direction"]),
    "cone": Layer("cone of the cost, by cos θₐ", ("cone of the cost",), _gradient(ASSISTANCE_STOPS)),
    "limits": Layer("joints, by use of their limits", ("joint limits",), _gradient(USAGE_STOPS)),
    "clearance": Layer("least clearance", ("clearance",), _gradient(USAGE_STOPS)),
}
"""Every layer by the name that `show` takes, in the order of the legend."""

DEFAULT = (
    "robot",
    "ghosts",
    "target",
    "obstacles",
    "client",
    "actuators",
    "planned_path",
    "tracked_path",
    "base_motion",
    "direction",
    "cone",
)
"""What is shown unless it is said otherwise; the rest is in the scene too, switched off."""


def chosen_layers(show: str | Sequence[str] | None) -> set[str]:
    """The layers that `show` names: None for the default ones, "all", one name, or several."""
    if show is None:
        return set(DEFAULT)
    if isinstance(show, str):
        show = tuple(LAYERS) if show == "all" else (show,)
    chosen = list(show)
    for name in chosen:
        if name not in LAYERS:
            raise InvalidValue("show", name, f"knows 'all', {', '.join(LAYERS)}")
    return set(chosen)
