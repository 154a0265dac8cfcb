"""What a step aims at: the paper's cone, or one of the classical ways to go straight to the target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.step_kinetics import StepKinetics

__all__ = ["AIMS", "Aim"]


@dataclass(frozen=True)
class Aim:
    """Where the end effector should go, and what its redundancy should spare.

    Attributes
    ----------
    on_cone : bool
        Whether to move on the cone where the paper's cost vanishes; otherwise straight to the target.
    effort : callable or None
        From kinetics to the matrix W (n, n) of the redundant motion's price, rates^T W rates, scaled to a
        mean diagonal of one. None: the identity.
    description : str
    """

    on_cone: bool
    effort: Callable[[StepKinetics], FloatArray] | None
    description: str


def _base_rotation(kinetics: StepKinetics) -> FloatArray:
    """Square of the base's angular velocity: its null space is the reaction null space."""
    spin = kinetics.coupling[3:]
    return _scaled(spin.T @ spin)


def _kinetic_energy(kinetics: StepKinetics) -> FloatArray:
    """The reduced inertia H_q: twice the kinetic energy of the floating system."""
    return _scaled(kinetics.M[6:, 6:] + kinetics.M[6:, :6] @ kinetics.coupling)


def _scaled(W: FloatArray) -> FloatArray:
    mean = float(np.trace(W)) / W.shape[0]
    return W / mean if mean > 0.0 else W


AIMS: dict[str, Aim] = {
    "step": Aim(True, None, "the paper's cost as a convex step on its cone"),
    "resolved-rate": Aim(False, None, "resolved motion rate control through J* (Umetani and Yoshida 1989)"),
    "least-disturbance": Aim(
        False, _base_rotation, "least base rotation: redundancy in the reaction null space (Yoshida 2001)"
    ),
    "minimum-effort": Aim(False, _kinetic_energy, "least kinetic energy: the H_q-weighted inverse of J*"),
}
