"""Marching single steps into a whole motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.step.stepper import Step
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

__all__ = ["March", "Progress", "Steps", "march", "sides_across", "start_sides"]

Progress: TypeAlias = Callable[[float], None]


class Steps(Protocol):
    """What `march` needs: one step after the other."""

    sms: SpaceManipulator
    dt: float
    momentum: FloatArray | None
    mode: str

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
    ) -> Step:
        """Joint rates for the next step."""


class March(NamedTuple):
    """A motion made of steps.

    Attributes
    ----------
    rates : ndarray, shape (N + 1, n)
        Joint rates at the nodes [rad/s], linear in between; the first row is the start.
    note : str
        In how many steps the arm braked, in words; empty where every step was solved.
    """

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
