"""Tables [[term]] and [[limit]] of a scenario file: ours by a short name, a user's own by an import path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, get_args

from pydantic import ConfigDict, Discriminator, Tag

from ffsms_pin.scenarios.keys import Keys, key
from ffsms_pin.scenarios.plan_tables import COLLISION, BaseMotion, Collision
from ffsms_pin.scenarios.values import NotNegative, Positive, Text

__all__ = ["OWN", "PARTS", "LimitTable", "TermTable"]

OWN = "package.module:Class"


def _use(what: str) -> Any:
    return key("", "", what, required=True)


class OwnPart(Keys):
    """A class of the user's own; the other keys are its keyword arguments."""

    model_config = ConfigDict(extra="allow")

    use: Text = _use(f'a class of your own, as "{OWN}"')


class CouplingTerm(Keys):
    """The paper's cost."""

    use: Literal["coupling"] = _use("the paper's cost; there by default")
    kappa: Positive = key("", "10", "sharpness of the paper's C~")
    weight: Positive = key("", "1", "")


class SmoothTerm(Keys):
    """Small joint accelerations."""

    use: Literal["smooth"] = _use("small joint accelerations; there by default")
    weight: NotNegative = key("", "1e-5", "")


class EffortTerm(Keys):
    """Little joint travel."""

    use: Literal["effort"] = _use("little joint travel; there by default")
    weight: NotNegative = key("", "1e-4", "")


class BaseTurnTerm(Keys):
    """Little turning of the base."""

    use: Literal["base-turn"] = _use("little turning of the base")
    weight: NotNegative = key("", "0.1", "")


class WheelMomentumTerm(Keys):
    """Little spin momentum of the wheels."""

    use: Literal["wheel-momentum"] = _use("where wheels hold the base: little spin momentum")
    weight: NotNegative = key("", "1", "")


class WheelEnergyTerm(Keys):
    """Little energy of the wheels' motors."""

    use: Literal["wheel-energy"] = _use("where wheels hold the base: little energy")
    weight: NotNegative = key("", "1", "")
    rounding: Positive = key("W", "1e-3", "power of a wheel below which its size is rounded off")


class PropellantTerm(Keys):
    """Little propellant."""

    use: Literal["propellant"] = _use("where thrusters hold the base: little propellant")
    weight: NotNegative = key("", "0.1", "")
    rounding: Positive = key("N", "1e-3", "force of a thruster below which its size is rounded off")


class JointsLimit(Keys):
    """The joints' limits."""

    use: Literal["joints"] = _use("the joints' limits, of [limits]; there by default")


class ClearanceLimit(Keys):
    """A clearance."""

    use: Literal["clearance"] = _use("a clearance; there by default")
    clearance: NotNegative = key("m", "0.01", "the paper's d_safe")
    collision: Collision = key("", '"auto"', COLLISION)


class BaseLimit(BaseMotion):
    """How far and how fast the base may move."""

    use: Literal["base"] = _use("how far and how fast the base may move")


class AlphaBoxLimit(Keys):
    """The paper's box of alpha."""

    use: Literal["alpha-box"] = _use("the paper's box of alpha, for whole motions too")


class TorquesLimit(Keys):
    """The joints' torques."""

    use: Literal["torques"] = _use("the joints' torques; there by default")


class WheelsLimit(Keys):
    """Torque and momentum of the wheels."""

    use: Literal["wheels"] = _use("the wheels' torque and momentum; there of itself where they hold the base")


def _which(given: Any) -> str:
    """Which table a row is: one of the library's by its name, else the user's own."""
    use = given.get("use") if isinstance(given, Mapping) else getattr(given, "use", None)
    return use if isinstance(use, str) and use.strip() and ":" not in use else "own"


TermTable: TypeAlias = Annotated[
    Annotated[CouplingTerm, Tag("coupling")]
    | Annotated[SmoothTerm, Tag("smooth")]
    | Annotated[EffortTerm, Tag("effort")]
    | Annotated[BaseTurnTerm, Tag("base-turn")]
    | Annotated[WheelMomentumTerm, Tag("wheel-momentum")]
    | Annotated[WheelEnergyTerm, Tag("wheel-energy")]
    | Annotated[PropellantTerm, Tag("propellant")]
    | Annotated[OwnPart, Tag("own")],
    Discriminator(_which),
]
LimitTable: TypeAlias = Annotated[
    Annotated[JointsLimit, Tag("joints")]
    | Annotated[ClearanceLimit, Tag("clearance")]
    | Annotated[BaseLimit, Tag("base")]
    | Annotated[AlphaBoxLimit, Tag("alpha-box")]
    | Annotated[TorquesLimit, Tag("torques")]
    | Annotated[WheelsLimit, Tag("wheels")]
    | Annotated[OwnPart, Tag("own")],
    Discriminator(_which),
]


def _tables_of(either: Any) -> dict[str, type[Keys]]:
    """The tables of a term or limit by their `use`; "own" is the user's."""
    kinds = (get_args(kind) for kind in get_args(get_args(either)[0]))
    return {tag.tag: table for table, tag in kinds}


PARTS: Mapping[str, Mapping[str, type[Keys]]] = {
    "term": _tables_of(TermTable),
    "limit": _tables_of(LimitTable),
}
"""The tables [[term]] and [[limit]] by their `use`; "own" is a class of the user's."""
