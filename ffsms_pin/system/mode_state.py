"""The paper's coupling where something of the base is held."""

from __future__ import annotations

from typing import NamedTuple

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import decompose
from ffsms_pin.coupling.metrics import entropy_of_values
from ffsms_pin.system.base_reaction import mode_coupling
from ffsms_pin.system.state import State


class ModeCoupling(NamedTuple):
    """The coupling of a mode at one state.

    Attributes
    ----------
    C_bm : ndarray, shape (6, n)
        Base twist a joint rate; rows of what is held are zero.
    sigma : ndarray, shape (min(6, n),)
        Its singular values; those beyond the rows that are free are zero.
    V : ndarray, shape (n, n)
        Right singular vectors.
    entropy : float
        H_norm: at most log 3 / log n where three rows are free, and zero where there is no coupling.
    J_star : ndarray, shape (6, n)
        Generalised Jacobian J_b C_bm + J_m of the mode.
    """

    C_bm: FloatArray
    sigma: FloatArray
    V: FloatArray
    entropy: float
    J_star: FloatArray


def coupling_of(state: State, mode: str) -> ModeCoupling:
    """The paper's measures with the C_bm of a mode in place of the floating base's."""
    C_bm = mode_coupling(state.H_b, state.H_bm, mode)
    _, sigma, V = decompose(C_bm)
    return ModeCoupling(
        C_bm, sigma, V, entropy_of_values(sigma.tolist(), C_bm.shape[1]), state.J_b @ C_bm + state.J_m
    )
