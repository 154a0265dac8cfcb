"""Marching single steps into a whole motion, and braking, which a step falls back to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.motion.rollout import rolled_out
from ffsms_pin.opt.parts.reading import violation_of
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

if TYPE_CHECKING:
    from ffsms_pin.opt.step.stepper import Step

Progress: TypeAlias = Callable[[float], None]  # told the share that is done


class Steps(Protocol):
    """What `march` needs of a `Stepper`."""

    sms: SpaceManipulator
    dt: float
    momentum: FloatArray | None
    mode: str

    def advance(self, *arguments: Any, **named: Any) -> Step:
        """Joint rates for the next step."""


class March(NamedTuple):
    """Joint rates (N + 1, n) at the nodes of a march [rad/s], and in how many steps the arm braked."""

    rates: FloatArray
    note: str


def march(
    stepper: Steps,
    q0: FloatArray,
    rates0: FloatArray,
    target: FloatArray,
    duration: float,
    rotation: FloatArray | None = None,
    progress: Progress | None = None,
) -> March:
    """Plan step by step to a target (3,) [m], and an attitude (3, 3); a new motion needs a `reset` first."""
    sms, dt = stepper.sms, stepper.dt
    steps = max(1, round(duration / dt))
    rates = np.empty((steps + 1, sms.n))
    q, rates[0], braked = q0, rates0, 0
    for k in range(steps):
        step = stepper.advance(q, rates[k], target, duration - k * dt, rotation)
        braked += not step.solved
        rates[k + 1] = step.joint_rates
        slope = (rates[k + 1] - rates[k]) / dt
        q, _ = advance(sms, q, rates[k], slope, dt, stepper.momentum, stepper.mode)
        if progress is not None:
            progress((k + 1) / steps)
    note = f"the arm braked in {braked} of {steps} steps whose programme was not solved" if braked else ""
    return March(rates, note)


def sides_across(way: FloatArray, J: FloatArray) -> list[FloatArray]:
    """Unit vectors across a way (3,) along which J (3, n) can move, both senses of the strongest two.

    For a planar arm the two sides of the way.
    """
    distance = float(np.linalg.norm(way))
    across = np.eye(3) if distance < 1e-12 else np.eye(3) - np.outer(way, way) / distance**2
    directions, strengths, _ = np.linalg.svd(across @ J)
    usable = [directions[:, i] for i in range(min(2, len(strengths))) if strengths[i] > 1e-6]
    return [sign * direction for direction in usable for sign in (1.0, -1.0)]


def braking(step: StepState) -> FloatArray:
    """Rates (n,) at the step's end of an arm that brakes as fast as its joints may [rad/s].

    All of them in the same time: so what cancels in the base's motion goes on to cancel.
    """
    slower: FloatArray = step.rates * max(0.0, 1.0 - step.dt / max(_stop(step, step.rates), 1e-12))
    return slower


def stoppable(limits: Sequence[Limit], step: StepState, rates: FloatArray, slower: FloatArray) -> FloatArray:
    """Joint rates (n,) for the step's end after which the arm can still stop with limits kept.

    Where stopping after this step would break one, they go part of the way to those of braking, `slower`
    (n,), or all of it: that was safe one step ago.
    """
    if not _broken(limits, step, rates).any():
        return rates
    most = _broken(limits, step, slower)  # where a limit is broken already, coming back must be possible
    for share in (0.5, 0.25, 0.1):
        between = slower + share * (rates - slower)
        if (_broken(limits, step, between) <= most).all():
            return between
    return slower


def _broken(limits: Sequence[Limit], step: StepState, end: FloatArray) -> FloatArray:
    """By how much each limit is broken if the arm goes to rates `end` and then stops, in five steps."""
    sms, momentum = step.sms, step.momentum
    q, _ = advance(sms, step.q, step.rates, (end - step.rates) / step.dt, step.dt, momentum, step.mode)
    slowing = np.linspace(1.0, 0.0, 6)[:, None] * end
    dt, start = max(_stop(step, end), step.dt) / 5, pin.XYZQUATToSE3(step.base_start)
    motion = replace(
        rolled_out(sms, sms.arm_stack(step.mode), q, slowing, dt, momentum),
        base_start=start.act(sms.base_com),
        rotation_start=start.rotation,
        wheels=step.wheels,
        wheel_total=step.features.motions.wheel_total,
    )
    return np.array([violation_of(limit, motion).amount for limit in limits])


def _stop(step: StepState, rates: FloatArray) -> float:
    """In what time the arm may stop from joint rates [s]."""
    return float(np.max(np.abs(rates) / step.sms.limits.acceleration))
