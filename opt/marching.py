"""Marching single steps into a whole motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.step.result import Step
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

__all__ = ["Progress", "Stepper", "march", "rank", "start_sides"]

Progress: TypeAlias = Callable[[float], None]


class Stepper(Protocol):
    """What `march` needs: one step after the other."""

    sms: SpaceManipulator
    dt: float
    kappa: float
    momentum: FloatArray | None

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
    ) -> Step:
        """Joint rates for the next step."""


def march(
    planner: Stepper,
    q0: FloatArray,
    target: FloatArray,
    duration: float,
    progress: Progress | None = None,
    rotation: FloatArray | None = None,
) -> Trajectory:
    """Plan step by step from rest at q0, each step a single quadratic programme."""
    sms, dt = planner.sms, planner.dt
    steps = max(1, round(duration / dt))
    t = np.linspace(0.0, duration, steps + 1)
    q, rates = np.empty((steps + 1, sms.nq)), np.zeros((steps + 1, sms.n))
    q[0] = q0
    braked = 0
    for k in range(steps):
        step = planner.advance(q[k], rates[k], target, duration - t[k], rotation)
        braked += not step.solved
        rates[k + 1] = step.joint_rates
        q[k + 1], _ = advance(sms, q[k], rates[k], (rates[k + 1] - rates[k]) / dt, dt, planner.momentum)
        if progress is not None:
            progress((k + 1) / steps)
    note = f"the arm braked in {braked} of {steps} steps whose programme was not solved" if braked else ""
    return measure(sms, t, q, rates, target, planner.kappa, note, rotation, planner.momentum)


def start_sides(sms: SpaceManipulator, q0: FloatArray, target: FloatArray) -> list[FloatArray]:
    """Directions across the way to the target in which the end effector can move at the start.

    For a planar arm the two sides of the way; in space both senses of the two principal directions.
    """
    kinetics = step_kinetics(sms, q0)
    way = target - kinetics.position
    distance = float(np.linalg.norm(way))
    across = np.eye(3) if distance < 1e-12 else np.eye(3) - np.outer(way, way) / distance**2
    directions, strengths, _ = np.linalg.svd(across @ kinetics.J_v)
    usable = [directions[:, i] for i in range(2) if i < len(strengths) and strengths[i] > 1e-6]
    return [sign * direction for direction in usable for sign in (1.0, -1.0)] or [np.zeros(3)]


def rank(plan: Trajectory) -> tuple[bool, float]:
    """Plans that arrive by cost, before the others by how near they come."""
    return not plan.reached, plan.cost_integral if plan.reached else float(plan.position_error[-1])
