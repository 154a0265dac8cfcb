"""Marching single steps into a whole motion, and braking, which a step falls back to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

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

__all__ = [
    "March",
    "Progress",
    "Steps",
    "braking",
    "march",
    "sides_across",
    "start_sides",
    "stoppable",
    "within",
]

_SHARES = (0.5, 0.25, 0.1)  # of the way from braking to what the programme wants
_STOPS = 5  # steps of an arm that stops

Progress: TypeAlias = Callable[[float], None]


class Steps(Protocol):
    """What `march` needs: one step after the other."""

    sms: SpaceManipulator
    dt: float
    momentum: FloatArray | None
    mode: str

    @property
    def advance(self) -> Callable[..., Step]:
        """Joint rates for the next step: as `Stepper.advance`."""


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
    """Plan step by step, each step a single quadratic programme.

    Parameters
    ----------
    stepper : Stepper or NonlinearStepper
        Goes on from what it remembers; `reset` comes first for a new motion.
    q0, rates0 : ndarray, shape (nq,), (n,)
        At the start.
    target : ndarray, shape (3,)
        Inertial axes [m].
    duration : float
        [s], rounded to whole steps.
    rotation : ndarray, shape (3, 3), optional
        Wanted attitude of the end effector at the end.
    progress : callable, optional
        Told the share that is done.
    """
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


def start_sides(
    sms: SpaceManipulator, q0: FloatArray, target: FloatArray, mode: str = "floating"
) -> list[FloatArray]:
    """Directions across the way to the target in which the end effector can move at the start.

    For a planar arm the two sides of the way; in space both senses of the two principal directions.
    """
    step = StepState(sms, q0, np.zeros(sms.n), 1.0, 1.0, mode=mode)
    return sides_across(target - step.pose.translation, step.J_star[:3]) or [np.zeros(3)]


def sides_across(way: FloatArray, J: FloatArray) -> list[FloatArray]:
    """Unit vectors across a way (3,) along which J (3, n) can move: both senses of the strongest two."""
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


def within(rates: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Rates (n,), or the nearest to them within bounds."""
    return np.minimum(np.maximum(rates, bounds[0]), bounds[1])


def stoppable(limits: Sequence[Limit], step: StepState, rates: FloatArray, slower: FloatArray) -> FloatArray:
    """Joint rates (n,) for the step's end after which the arm can still stop with limits kept.

    What would happen if it stopped after this step is rolled out. Where that breaks a limit the rates go part
    of the way to braking, or all of it: that was safe one step ago.

    Parameters
    ----------
    limits : sequence of Limit
    step : StepState
    rates, slower : ndarray, shape (n,)
        Wanted rates at the step's end, and those of braking [rad/s].
    """
    if not _broken(limits, step, rates).any():
        return rates
    most = _broken(limits, step, slower)  # where a limit is broken already, coming back must be possible
    for share in _SHARES:
        between = slower + share * (rates - slower)
        if (_broken(limits, step, between) <= most).all():
            return between
    return slower


def _broken(limits: Sequence[Limit], step: StepState, end: FloatArray) -> FloatArray:
    """By how much each limit is broken if the arm goes to rates `end` and then stops."""
    sms, momentum = step.sms, step.momentum
    q, _ = advance(sms, step.q, step.rates, (end - step.rates) / step.dt, step.dt, momentum, step.mode)
    slowing = np.linspace(1.0, 0.0, _STOPS + 1)[:, None] * end
    dt, start = max(_stop(step, end), step.dt) / _STOPS, pin.XYZQUATToSE3(step.base_start)
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
