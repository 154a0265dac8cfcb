"""Tables of a scenario file about the plan: its time, its method, its terms and limits.

A [[term]] or [[limit]] is one of the library's by a short name, or a user's own by an import path.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, Union, get_args

from pydantic import ConfigDict, Discriminator, Tag, create_model

from ffsms_pin.opt import (
    METHODS,
    AlphaBox,
    BaseLimits,
    BaseTurn,
    Clearance,
    Coupling,
    Effort,
    JointLimits,
    Propellant,
    Smooth,
    TorqueLimits,
    WheelEnergy,
    WheelLimits,
    WheelMomentum,
)
from ffsms_pin.scenarios.keys import Keys, angle, key, table
from ffsms_pin.scenarios.values import Limit, NotNegative, OneOf, Positive, Text, Texts, Vector6

__all__ = ["HELD_BY", "OWN", "PACKAGED", "PARTS", "BaseMotion", "LimitTable", "Plan", "TermTable", "is_own"]

# Modes of a plan that a closed loop can follow, and what then holds the attitude.
HELD_BY: Mapping[str, str] = {
    "rotation-floating": "wheels",
    "rotation-flying": "thrusters",
    "translation-flying": "thrusters",
    "flying": "thrusters",
}


_Collision: TypeAlias = Literal["auto", "points", "hulls", "shapes", "off"]
_COLLISION = (
    'what is kept clear: the paper\'s "points", the URDF\'s shapes in convex parts ("hulls") or as they are '
    '("shapes"), or "off"; "auto": hulls where there are shapes, points for planar arms'
)


class BaseMotion(Keys):
    """[plan.base_limits]: how far and how fast the base may move."""

    attitude: Limit = angle("rad", "inf", "largest turn of the base from its start")
    attitude_rate: Limit = angle("rad/s", "inf", "largest angular speed")
    translation: Limit = key("m", "inf", "largest distance of its centre of mass from the start")
    final_attitude: Limit = angle("rad", "inf", "largest turn that is left at the end")


class Plan(Keys):
    """[plan]: how the motion is planned."""

    duration: Positive = key(
        "s", "12", "time to arrive. Ours: 1.5 to 3 times what the joint limits need in the paper's cases"
    )
    dt: Positive = key("s", "0.01", "planning step. Ours; the paper states none")
    kappa: Positive = key("", "10", "sharpness of the paper's C~. Ours: close to max(0, cos(theta_a))")
    clearance: NotNegative = key("m", "0.01", "the paper's d_safe")
    collision: _Collision = key("", '"auto"', _COLLISION)
    method: Annotated[str, OneOf(METHODS)] = key(
        "", '"horizon"', "one of `opt.METHODS`; the others are there for comparison"
    )
    reach: Positive = key(
        "m",
        "0.02",
        "the paper's r_th. A plan that is within it from 0.9 T on has reached; a closed loop that ends "
        "within it has arrived",
    )
    momentum: Vector6 = key(
        "kg m/s, kg m²/s",
        "none",
        "total momentum (6 numbers) about the centre of mass that the plan counts on, and that the "
        "plant then has",
    )
    effort: NotNegative = key("", "1e-4", 'weight on joint travel: `opt.Effort`; for "horizon"')
    base: NotNegative = key("", "0", 'weight on the turning of the base: `opt.BaseTurn`; for "horizon"')
    time_limit: Positive = key(
        "s",
        "none",
        'after so long the best plan so far is taken; for "horizon". The plan then depends on how fast '
        "the machine is",
    )
    locked: Texts = key(
        "", "[]", 'names of joints that cannot move, in the plan and in re-planning; for "horizon"'
    )
    mode: Annotated[str, OneOf(("floating", *HELD_BY))] = key(
        "",
        '"floating"',
        'what of the base is held, as `opt.Problem` has it: with "rotation-floating" the attitude, by '
        'wheels, with "rotation-flying" by thrusters; with "translation-flying" the place of its centre'
        ' of mass, and with "flying" both, by thrusters and `law = "station-keeping"` ([bases that '
        "act](bases-that-act.md)). It needs a table [attitude]",
    )
    base_limits: BaseMotion = table()


OWN = "package.module:Class"


class OwnPart(Keys):
    """A class of the user's own; the other keys are its keyword arguments."""

    model_config = ConfigDict(extra="allow")

    use: Text = key("", "", f'a class of your own, as "{OWN}"', required=True)


def _part(use: str, what: str, base: type[Keys] = Keys, **keys: tuple[Any, Any]) -> type[Keys]:
    """The table of a term or limit of the library: its name, what it is, and its keys."""
    fields: dict[str, Any] = {"use": (Literal[use], key("", "", what, required=True)), **keys}
    title = "".join(word.capitalize() for word in use.split("-"))
    return create_model(title, __base__=base, __doc__=f"{what}.", **fields)


def _weight(default: str, kind: Any = NotNegative) -> tuple[Any, Any]:
    return kind, key("", default, "")


_CLEARANCE = (NotNegative, key("m", "0.01", "the paper's d_safe"))
_KAPPA = (Positive, key("", "10", "sharpness of the paper's C~"))
_WATT = (Positive, key("W", "1e-3", "power of a wheel below which its size is rounded off"))
_NEWTON = (Positive, key("N", "1e-3", "force of a thruster below which its size is rounded off"))

_OURS: Mapping[str, Mapping[type, type[Keys]]] = {
    "term": {
        Coupling: _part(
            "coupling", "the paper's cost; there by default", kappa=_KAPPA, weight=_weight("1", Positive)
        ),
        Smooth: _part("smooth", "small joint accelerations; there by default", weight=_weight("1e-5")),
        Effort: _part("effort", "little joint travel; there by default", weight=_weight("1e-4")),
        BaseTurn: _part("base-turn", "little turning of the base", weight=_weight("0.1")),
        WheelMomentum: _part(
            "wheel-momentum", "where wheels hold the base: little spin momentum", weight=_weight("1")
        ),
        WheelEnergy: _part(
            "wheel-energy", "where wheels hold the base: little energy", weight=_weight("1"), rounding=_WATT
        ),
        Propellant: _part(
            "propellant",
            "where thrusters hold the base: little propellant",
            weight=_weight("0.1"),
            rounding=_NEWTON,
        ),
    },
    "limit": {
        JointLimits: _part("joints", "the joints' limits, of [limits]; there by default"),
        Clearance: _part(
            "clearance",
            "a clearance; there by default",
            clearance=_CLEARANCE,
            collision=(_Collision, key("", '"auto"', _COLLISION)),
        ),
        BaseLimits: _part("base", "how far and how fast the base may move", BaseMotion),
        AlphaBox: _part("alpha-box", "the paper's box of alpha, for whole motions too"),
        TorqueLimits: _part("torques", "the joints' torques; there by default"),
        WheelLimits: _part(
            "wheels", "the wheels' torque and momentum; there of itself where they hold the base"
        ),
    },
}


def _use(table: type[Keys]) -> str:
    """The name of a term or limit in a file."""
    return str(get_args(table.model_fields["use"].annotation)[0])


PACKAGED: Mapping[str, Mapping[str, type]] = {
    kind: {_use(table): made for made, table in tables.items()} for kind, tables in _OURS.items()
}
"""The library's own terms and limits by their names in a scenario file."""

PARTS: Mapping[str, Mapping[str, type[Keys]]] = {
    kind: {**{_use(table): table for table in tables.values()}, "own": OwnPart}
    for kind, tables in _OURS.items()
}
"""The tables [[term]] and [[limit]] by their `use`; "own" is a class of the user's."""


def is_own(use: str) -> bool:
    """Whether `use` is a user's own class, as "package.module:Class"."""
    return ":" in use


def _which(given: Any) -> str:
    """Which table a row is: one of the library's by its name, else the user's own."""
    use = given.get("use") if isinstance(given, Mapping) else getattr(given, "use", None)
    return use if isinstance(use, str) and use.strip() and not is_own(use) else "own"


def _either(tables: Mapping[str, type[Keys]]) -> Any:
    """One of several tables, by its `use`."""
    tagged = tuple(Annotated[table, Tag(use)] for use, table in tables.items())
    return Annotated[Union[tagged], Discriminator(_which)]  # noqa: UP007


TermTable: Any = _either(PARTS["term"])
LimitTable: Any = _either(PARTS["limit"])
