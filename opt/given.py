"""What `plan`, `Problem` and `StepPlanner` are given: defaults, and checks of parts, times and joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, instance, number, positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.limits import (
    AlphaBox,
    Clearance,
    JointLimits,
    Limit,
    Obstacle,
    TorqueLimits,
    WheelLimits,
)
from ffsms_pin.opt.terms import BaseTurn, Coupling, Effort, Smooth, Term
from ffsms_pin.system import SpaceManipulator

__all__ = [
    "check_joints",
    "checked_locked",
    "checked_parts",
    "checked_times",
    "default_limits",
    "default_terms",
    "step_limits",
    "with_defaults",
]

MOST_STEPS = 1_000_000  # some 400 MB for seven joints


def default_terms(
    kappa: float = Coupling.kappa, effort: float | None = None, base: float = 0.0, coupled: bool = True
) -> tuple[Term, ...]:
    """What a motion should be like where nothing else is asked for; for `coupled` see `Goal.coupled`."""
    cost = (Coupling(kappa),) if coupled else ()
    spared = (BaseTurn(base),) if number("base", base) != 0.0 else ()
    return (*cost, Smooth(), Effort() if effort is None else Effort(effort), *spared)


def default_limits(
    clearance: float = Clearance.clearance,
    collision: str = Clearance.collision,
    obstacles: Sequence[Obstacle] = (),
    base: Limit | None = None,
) -> tuple[Limit, ...]:
    """What must hold where nothing else is asked for: limits of the joints and their torques, a clearance."""
    instance("base_limits", base, Limit, optional=True)
    kept = (JointLimits(), TorqueLimits(), Clearance(clearance, collision, obstacles=obstacles))
    return kept if base is None else (*kept, base)


def step_limits(limits: Sequence[Limit], mode: str = "floating") -> tuple[Limit, ...]:
    """Limits of single steps: the paper has the box on alpha always; and wheels, where they hold the base."""
    more = (AlphaBox(), WheelLimits()) if mode == "rotation-floating" else (AlphaBox(),)
    return with_defaults(limits, *more)


def with_defaults(limits: Sequence[Limit], *more: Limit) -> tuple[Limit, ...]:
    """Limits, and of some more those of which they have none by the name."""
    return (*limits, *(one for one in more if one.name not in [limit.name for limit in limits]))


def checked_parts(name: str, parts: Any, kind: type) -> tuple[Any, ...]:
    """Parts of one kind, each with a name of its own."""
    for part in parts if isinstance(parts, Sequence) else [parts]:
        if not isinstance(part, kind) or part is parts:
            raise InvalidValue(name, part, f"must be a sequence of opt.{kind.__name__}")
        if not isinstance(getattr(part, "name", None), str):
            raise InvalidValue(name, part, "must have a `name` each, a text")
    names = [part.name for part in parts]
    for one in names:
        if names.count(one) > 1:
            raise InvalidValue(name, one, "must have one part of each name; give yours another `name`")
    return tuple(parts)


def checked_times(duration: Any, dt: Any) -> tuple[float, float]:
    """Duration and step [s]; a whole number of steps makes up the duration."""
    duration, dt = positive("duration", duration, "s"), positive("dt", dt, "s")
    if duration < dt:
        raise InvalidValue("duration", duration, f"must be at least one step of {dt:g} s")
    if duration / dt > MOST_STEPS:
        most = f"must be at most {MOST_STEPS} steps of {dt:g} s; take a longer dt"
        raise InvalidValue("duration", duration, most)
    return duration, duration / round(duration / dt)


def checked_locked(sms: SpaceManipulator, locked: Any) -> tuple[str, ...]:
    """Names of joints that cannot move."""
    if isinstance(locked, str) or not isinstance(locked, Sequence):
        raise InvalidValue("locked", locked, "must be a sequence of joint names")
    for name in locked:
        if name not in sms.joint_names:
            raise InvalidValue("locked", name, f"must be a joint: {', '.join(sms.joint_names)}")
    return tuple(locked)


def check_joints(sms: SpaceManipulator, limits: Any, positions: FloatArray) -> None:
    """Raise `InvalidValue` where joint positions (n,) [rad] are outside joint limits."""
    outside = limits.violation(positions)
    if outside.any():
        i = int(np.argmax(outside))
        raise InvalidValue(
            f"q0: joint '{sms.joint_names[i]}'",
            round(float(positions[i]), 6),
            f"must start within [{limits.lower[i]:.6g}, {limits.upper[i]:.6g}] rad",
        )
