"""Tables of a scenario file about the plan: its time, its method, its terms and limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

from ffsms_pin.opt import METHODS
from ffsms_pin.scenarios.keys import Keys, angle, key, table
from ffsms_pin.scenarios.values import (
    Limit,
    NotNegative,
    OneOf,
    Positive,
    Texts,
    Vector6,
)

__all__ = ["COLLISION", "HELD_BY", "BaseMotion", "Collision", "Plan"]

#: Modes of a plan that a closed loop can follow, and what then holds the attitude.
HELD_BY: Mapping[str, str] = {
    "rotation-floating": "wheels",
    "rotation-flying": "thrusters",
    "translation-flying": "thrusters",
    "flying": "thrusters",
}


Collision: TypeAlias = Literal["auto", "points", "hulls", "shapes", "off"]
COLLISION = (
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
    collision: Collision = key("", '"auto"', COLLISION)
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
