"""Motions whose parts are given one by one: of a single step, and moved a little for differences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import HeldMotions, Motions
from ffsms_pin.opt.motion.slopes import coupling_slopes
from ffsms_pin.system.batch.stacks import apply, exp3, skew

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

__all__ = ["MOVED_VECTORS", "Change", "StepFeatures", "by_differences", "difference", "movers"]

# Velocities, by what they move.
_VELOCITIES = {"by_velocity": "by_tip", "by_spin": "by_turn", "by_base_spin": "by_base_turn"}
# What moves alone in a difference: fields of motions by the names of slopes.
_VECTORS = {
    "by_tip": "end_effector",
    "by_velocity": "velocity",
    "by_spin": "spin",
    "by_base": "base_position",
    "by_base_spin": "base_spin",
}
_TURNS = {"by_turn": "attitude", "by_base_turn": "base_attitude"}
MOVED_VECTORS = (*_VECTORS, *_TURNS)
_JOINTS = {"by_joints": "joints", "by_rates": "rates", "by_accelerations": "accelerations"}


class Change(NamedTuple):
    """How c features at a step's start change with its joint rates u.

    `value` (c,) is at the state, with the rates of the step's start. By what moves they change by
    flow (c, n) @ u + flow_drift (c,) a second; by the rates themselves, at the same state, by jump (c, n).
    """

    value: FloatArray
    flow: FloatArray
    flow_drift: FloatArray
    jump: FloatArray


class StepFeatures(Features):
    """What a part sees of a single step: a motion of one instant, shape (..., 1, 1).

    What the step has worked out already is taken from it; the rest of the arm only where a part asks for it.
    """

    step: StepState

    def __init__(self, step: StepState) -> None:
        self.step = step
        stack, R = step.sms.arm_stack(step.mode), pin.Quaternion(step.q[3:7]).toRotationMatrix()
        start = pin.XYZQUATToSE3(step.base_start)
        u, com = step.rates, step.sms.base_com
        # The base's centre of mass, the base's turn and the end effector: a joint rate each, and the drift.
        root = np.column_stack([step.reaction, step.drift])
        base, base_turn = R @ (root[:3] - skew(com) @ root[3:]), R @ root[3:]
        tip = np.column_stack([step.J_star, step.tip_drift])
        self._moved = {"by_tip": tip[:3], "by_turn": tip[3:], "by_base": base, "by_base_turn": base_turn}
        at = np.append(u, 1.0)
        motions = HeldMotions(
            stack=stack,
            times=np.array([step.time]),
            weights=np.ones(1),
            limit_weights=np.ones(1),
            last_tenth=np.zeros(1, dtype=np.intp),
            joints=_one(step.joints),
            rates=_one(u),
            accelerations=_one(np.zeros(len(u))),
            base_attitude=_one(R),
            com=(step.q[:3] + R @ step.com)[:, None],
            drift=np.zeros(3) if step.momentum is None else step.momentum[:3] / stack.total_mass,
            own_spin=_one(step.drift[3:]),
            base_start=start.act(com),
            rotation_start=start.rotation,
            target=np.full((3, 1), np.nan),
            mean_speed=np.nan,
            wheels=step.wheels,
            wheel_total=np.zeros(len(step.wheels or ())) if step.wheel_total is None else step.wheel_total,
            end_effector=_one(step.pose.translation),
            attitude=_one(step.pose.rotation),
            velocity=_one(tip[:3] @ at),
            spin=_one(tip[3:] @ at),
            base_spin=_one(base_turn @ at),
            base_position=_one(step.q[:3] + R @ com),
        )
        super().__init__(motions, step.time + step.time_left)

    def change(self, feature: Feature) -> Change:
        """What the step's joint rates do to a feature of it."""
        m, n, c = self.motions, self.step.sms.n, feature.value.size
        flow, jump = np.zeros((c, n + 1)), np.zeros((c, n))
        for name, slope in (feature._by() if feature.ndim == 3 else feature.slopes).items():
            if name == "by_entropy":
                name, slope = "by_coupling", slope[..., None, None, :, :] * m.entropy_slope
            if name == "by_coupling":
                flow[:, :n] += coupling_slopes(m.stack, m.arm, slope).reshape(-1, n)
                continue
            slope = slope.reshape(c, -1)
            if name in self._moved:
                flow += slope @ self._moved[name]
            elif name in _VELOCITIES:
                jump += slope @ self._moved[_VELOCITIES[name]][:, :n]
            elif name == "by_time":
                flow[:, n] += slope[:, 0]
            elif name == "by_joints":
                flow[:, :n] += slope
            else:
                jump += slope / (self.step.dt if name == "by_accelerations" else 1.0)
        return Change(feature.value.reshape(c), flow[:, :n], flow[:, n], jump)


def _one(x: Any) -> FloatArray:
    """As of one motion at one instant; a copy, since the state's may be read-only views."""
    return np.array(x, dtype=np.float64)[..., None, None]


# -- differences


@dataclass(frozen=True, eq=False, kw_only=True)
class _Nudged(HeldMotions):
    """All that is worked out from other values is given, so that these can change alone."""

    entropy_and_slope: tuple[FloatArray, FloatArray]


def movers(motions: Motions) -> Iterator[tuple[str, int]]:
    """Everything that may move, by the names of slopes, and its components."""
    for name in MOVED_VECTORS:
        yield from ((name, i) for i in range(3))
    yield "by_entropy", 0
    for name in _JOINTS:
        yield from ((name, i) for i in range(motions.stack.n))


def _nudged(motions: Motions, name: str, i: int, by: float) -> Motions:
    """The motions with component i of what is called `name` moved by so much, at all instants."""
    values: dict[str, Any] = {one.name: getattr(motions, one.name) for one in fields(_Nudged)}
    values["evaluated"] = None if name == "by_joints" else motions.arm
    if name == "by_entropy":
        values["entropy_and_slope"] = (motions.entropy + by, motions.entropy_slope)
    elif name in _TURNS:
        values[_TURNS[name]] = apply(exp3(by * np.eye(3)[i])[..., None, None], values[_TURNS[name]])
    else:
        moved = (_VECTORS | _JOINTS)[name]
        values[moved] = values[moved].copy()
        values[moved][i] += by
    return _Nudged(**values)


def difference(formula: Callable[[Motions], FloatArray], motions: Motions, name: str, i: int) -> FloatArray:
    """A formula's slope by component i of what is called `name`; zero where it is not finite."""
    step = 1e-6  # [m, rad, 1/s of them]
    ahead, behind = (formula(_nudged(motions, name, i, by)) for by in (step, -step))
    apart = np.subtract(ahead, behind, out=np.zeros_like(ahead), where=np.isfinite(ahead))
    return apart / (2.0 * step)


def by_differences(formula: Callable[[Motions], FloatArray], motions: Motions) -> dict[str, FloatArray]:
    """Slopes of a formula (S, K) or (c, S, K) by everything that may move it, by central differences."""
    found: dict[str, list[FloatArray]] = {}
    for name, i in movers(motions):
        found.setdefault(name, []).append(difference(formula, motions, name, i))
    slopes = {name: np.stack(one, axis=one[0].ndim - 2) for name, one in found.items() if np.any(one)}
    if "by_entropy" in slopes:
        slopes["by_entropy"] = slopes["by_entropy"].squeeze(slopes["by_entropy"].ndim - 3)
    return slopes
