"""What a problem is given: defaults where nothing is, and checks, made once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen, number, positive, vector
from ffsms_pin.client import rest_momentum
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.limits import (
    AlphaBox,
    BaseLimits,
    Clearance,
    JointLimits,
    Limit,
    Obstacle,
    TorqueLimits,
    WheelLimits,
)
from ffsms_pin.opt.terms import BaseTurn, Coupling, Effort, Smooth, Term
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_reaction import MODES

__all__ = [
    "asked_momentum",
    "check_joints",
    "check_locked",
    "check_parts",
    "checked_momentum",
    "checked_times",
    "default_limits",
    "default_terms",
    "step_limits",
    "wheels_at_start",
    "with_defaults",
]

MOST_STEPS = 1_000_000  # some 400 MB for seven joints


def default_terms(
    kappa: float = Coupling.kappa, effort: float | None = None, base: float = 0.0, coupled: bool = True
) -> tuple[Term, ...]:
    """What a motion should be like where nothing else is asked for.

    `effort` and `base` weigh joint travel and turning of the base; for `coupled` see `Goal.coupled`.
    """
    cost = (Coupling(kappa),) if coupled else ()
    spared = (BaseTurn(base),) if number("base", base) != 0.0 else ()
    return (*cost, Smooth(), Effort() if effort is None else Effort(effort), *spared)


def default_limits(
    clearance: float = Clearance.clearance,
    collision: str = Clearance.collision,
    obstacles: Sequence[Obstacle] = (),
    base: BaseLimits | None = None,
) -> tuple[Limit, ...]:
    """What must hold where nothing else is asked for: limits of the joints and their torques, a clearance."""
    if base is not None and not isinstance(base, BaseLimits):
        raise InvalidValue("base_limits", base, "must be an opt.BaseLimits")
    kept = (JointLimits(), TorqueLimits(), Clearance(clearance, collision, obstacles=obstacles))
    return kept if base is None else (*kept, base)


def step_limits(limits: Sequence[Limit], mode: str = "floating") -> tuple[Limit, ...]:
    """Limits of single steps: the paper has the box on alpha always; and wheels, where they hold the base."""
    more = (AlphaBox(), WheelLimits()) if mode == "rotation-floating" else (AlphaBox(),)
    return with_defaults(limits, *more)


def with_defaults(limits: Sequence[Limit], *more: Limit) -> tuple[Limit, ...]:
    """Limits, and of some more those of which they have none by the name."""
    return (*limits, *(one for one in more if one.name not in [limit.name for limit in limits]))


def check_parts(name: str, parts: Any, kind: type) -> None:
    """Raise `InvalidValue` where parts are not a sequence of named parts of one kind."""
    for part in parts if isinstance(parts, Sequence) else [parts]:
        if not isinstance(part, kind) or part is parts:
            raise InvalidValue(name, part, f"must be a sequence of opt.{kind.__name__}")
        if not isinstance(getattr(part, "name", None), str):
            raise InvalidValue(name, part, "must have a `name` each, a text")
    names = [part.name for part in parts]
    for one in names:
        if names.count(one) > 1:
            raise InvalidValue(name, one, "must have one part of each name; give yours another `name`")


def checked_times(duration: Any, dt: Any) -> tuple[float, float]:
    """Duration and step [s]; a whole number of steps makes up the duration."""
    duration, dt = positive("duration", duration, "s"), positive("dt", dt, "s")
    if duration < dt:
        raise InvalidValue("duration", duration, f"must be at least one step of {dt:g} s")
    if duration / dt > MOST_STEPS:
        raise InvalidValue(
            "duration", duration, f"must be at most {MOST_STEPS} steps of {dt:g} s; take a longer dt"
        )
    return duration, duration / round(duration / dt)


def check_locked(sms: SpaceManipulator, locked: Any) -> None:
    """Raise `InvalidValue` where locked joints are not a sequence of joint names."""
    if isinstance(locked, str) or not isinstance(locked, Sequence):
        raise InvalidValue("locked", locked, "must be a sequence of joint names")
    for name in locked:
        if name not in sms.joint_names:
            raise InvalidValue("locked", name, f"must be a joint: {', '.join(sms.joint_names)}")


def checked_momentum(
    sms: SpaceManipulator, q0: FloatArray, goal: Goal, given: Any, mode: str
) -> FloatArray | None:
    """Total momentum (6,), that given or what the goal asks for; None: zero.

    `InvalidValue` for momentum that the base would have to turn or move with where it is held.
    """
    if given is not None:
        momentum: FloatArray | None = vector("momentum", given, 6)
    else:
        momentum = asked_momentum(goal, np.array(pin.centerOfMass(sms.model, sms.model.createData(), q0)))
    if momentum is None or not momentum.any():
        return None
    rows = MODES[mode]
    if len(rows) < 6 and (momentum[3:].any() or 0 not in rows):
        kept = "linear momentum only" if 0 in rows else "none"
        raise InvalidValue("momentum", momentum, f"must be {kept} in mode '{mode}': the base is held")
    return momentum


def asked_momentum(goal: Goal, com: FloatArray) -> FloatArray | None:
    """The total momentum (6,) that a goal asks for, the robot's centre of mass at com (3,); None: any."""
    return None if goal.at_rest_with is None else rest_momentum(goal.at_rest_with, com)


def wheels_at_start(sms: SpaceManipulator, mode: str, given: Any) -> FloatArray:
    """Momenta (w,) of the wheels that hold the attitude [N m s]; none where none do."""
    wheels = sms.wheels if mode == "rotation-floating" else None
    if given is None or np.size(given) == 0:
        return frozen(np.zeros(0 if wheels is None else len(wheels)))
    if wheels is None:
        raise InvalidValue(
            "wheel_momentum", given, "must be left out: in this mode no wheels hold the attitude"
        )
    return frozen(vector("wheel_momentum", given, len(wheels), "N m s"))


def check_joints(sms: SpaceManipulator, limits: Any, q0: FloatArray) -> None:
    """Raise `InvalidValue` where a start is outside joint limits."""
    positions = sms.layout.positions(q0)
    outside = limits.violation(positions)
    if outside.any():
        i = int(np.argmax(outside))
        raise InvalidValue(
            f"q0: joint '{sms.joint_names[i]}'",
            round(float(positions[i]), 6),
            f"must start within [{limits.lower[i]:.6g}, {limits.upper[i]:.6g}] rad",
        )
