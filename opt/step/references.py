"""What a step may follow: the paper's cone, or one of the classical ways to go straight to the target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.at_step import arm_stack
from ffsms_pin.opt.step.state import StepState

__all__ = ["REFERENCES", "Reference"]


@dataclass(frozen=True)
class Reference:
    """Where the end effector should go, and what its redundancy should spare.

    Attributes
    ----------
    on_cone : bool
        Whether to move on the cone where the paper's cost vanishes; otherwise straight to the target.
    effort : callable or None
        From the state to the matrix W (n, n) of the redundant motion's price, rates^T W rates, scaled to a
        mean diagonal of one. None: the identity.
    description : str
    """

    on_cone: bool
    effort: Callable[[StepState], FloatArray] | None
    description: str


def _base_rotation(step: StepState) -> FloatArray:
    """Square of the base's angular velocity: its null space is the reaction null space."""
    spin = step.reaction[3:]
    return _scaled(spin.T @ spin)


def _kinetic_energy(step: StepState) -> FloatArray:
    """The reduced inertia H_q: twice the kinetic energy of the floating system."""
    return _scaled(arm_stack(step.sms, step.mode).reduced_inertia(step.joints[:, None])[..., 0])


def _scaled(W: FloatArray) -> FloatArray:
    mean = float(np.trace(W)) / W.shape[0]
    return W / mean if mean > 0.0 else W


REFERENCES: dict[str, Reference] = {
    "step": Reference(True, None, "the paper's cost as a convex step on its cone"),
    "resolved-rate": Reference(
        False, None, "resolved motion rate control through J* (Umetani and Yoshida 1989)"
    ),
    "least-disturbance": Reference(
        False, _base_rotation, "least base rotation: redundancy in the reaction null space (Yoshida 2001)"
    ),
    "minimum-effort": Reference(
        False, _kinetic_energy, "least kinetic energy: the H_q-weighted inverse of J*"
    ),
}
