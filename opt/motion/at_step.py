"""The state of a single step as a motion of one instant, and what its joint rates do to features."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import HeldMotions
from ffsms_pin.opt.motion.slopes import coupling_slopes
from ffsms_pin.system.batch.stacks import skew

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

__all__ = ["Change", "StepFeatures"]

# Velocities of what the joint rates move.
_MOVES = {"by_velocity": "by_tip", "by_spin": "by_turn", "by_base_spin": "by_base_turn"}


class Change(NamedTuple):
    """How c features at a step's start change with its joint rates u.

    Attributes
    ----------
    value : ndarray, shape (c,)
        At the state, with the rates of the step's start.
    flow, flow_drift : ndarray, shape (c, n), (c,)
        By what moves, a second: flow @ u + flow_drift.
    jump : ndarray, shape (c, n)
        By the rates themselves, at a state that stays.
    """

    value: FloatArray
    flow: FloatArray
    flow_drift: FloatArray
    jump: FloatArray


class StepFeatures(Features):
    """What a part sees of a single step: a motion of one instant, shape (..., 1, 1).

    What the step has worked out already is taken from it; the rest of the arm only where a part asks for it.

    Parameters
    ----------
    step : StepState
    """

    def __init__(self, step: StepState) -> None:
        self.step = self.state = step
        stack, R = step.sms.arm_stack(step.mode), pin.Quaternion(step.q[3:7]).toRotationMatrix()
        start = pin.XYZQUATToSE3(step.base_start)
        u, com, centre = step.rates, step.sms.base_com, step.com
        # The base's centre of mass, the base's turn and the end effector: a joint rate each, and the drift.
        root = np.column_stack([step.reaction, step.drift])
        base, base_turn = R @ (root[:3] - skew(com) @ root[3:]), R @ root[3:]
        tip = np.column_stack([step.J_star, step.tip_drift])
        self._moved = {"by_tip": tip[:3], "by_turn": tip[3:], "by_base": base, "by_base_turn": base_turn}
        at = np.append(u, 1.0)
        drift = np.zeros(3) if step.momentum is None else step.momentum[:3] / stack.total_mass
        motions = HeldMotions(
            stack=stack,
            times=np.array([step.time]),
            weights=np.ones(1),
            limit_weights=np.ones(1),
            last_tenth=np.zeros(1, dtype=np.intp),
            last=0,
            joints=_one(step.joints),
            rates=_one(u),
            accelerations=_one(np.zeros(len(u))),
            base_attitude=_one(R),
            com=(step.q[:3] + R @ centre)[:, None],
            drift=drift,
            own_spin=_one(step.drift[3:]),
            base_start=start.act(com),
            rotation_start=start.rotation,
            target=np.full((3, 1), np.nan),
            mean_speed=np.nan,
            wheels=step.wheels,
            wheel_total=np.zeros(len(step.wheels or ())) if step.wheel_total is None else step.wheel_total,
            end_effector=_one(step.pose.translation),
            attitude=_one(step.pose.rotation),
            relative_velocity=_one(tip[:3] @ at - drift),
            spin=_one(tip[3:] @ at),
            base_spin=_one(base_turn @ at),
            base_from_com=_one(R @ (com - centre)),
        )
        super().__init__(motions, step.time + step.time_left)

    def change(self, feature: Feature) -> Change:
        """What the step's joint rates do to a feature of it."""
        n, c = self.state.sms.n, feature.value.size
        flow, jump = np.zeros((c, n + 1)), np.zeros((c, n))
        for name, slope in _slopes(feature).items():
            if name in ("by_entropy", "by_coupling"):
                flow[:, :n] += self._by_coupling(slope, name)
                continue
            slope = slope.reshape(c, -1)
            if name in self._moved:
                flow += slope @ self._moved[name]
            elif name in _MOVES:
                jump += slope @ self._moved[_MOVES[name]][:, :n]
            elif name == "by_time":
                flow[:, n] += slope[:, 0]
            elif name == "by_joints":
                flow[:, :n] += slope
            else:
                jump += slope / (self.state.dt if name == "by_accelerations" else 1.0)
        return Change(feature.value.reshape(c), flow[:, :n], flow[:, n], jump)

    def _by_coupling(self, slope: FloatArray, name: str) -> FloatArray:
        """Slopes (c, n) by the joint positions of what depends on the coupling."""
        m, rows = self.motions, []
        for one in slope.reshape(-1, *(m.entropy_slope.shape if name == "by_coupling" else (1, 1))):
            one = one if name == "by_coupling" else one * m.entropy_slope
            rows.append(coupling_slopes(m.stack, m.arm, one)[:, 0, 0])
        return np.array(rows)


def _slopes(feature: Feature) -> dict[str, Any]:
    return feature._by() if feature.ndim == 3 else feature.slopes


def _one(x: Any) -> FloatArray:
    """As of one motion at one instant; a copy, since the state's may be read-only views."""
    return np.array(x, dtype=np.float64)[..., None, None]
