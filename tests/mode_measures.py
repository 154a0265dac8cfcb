"""Compute the paper's measures in a base mode by NumPy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.system.dynamics import mode_coupling

Array = NDArray[np.float64]


class ModeMeasures(NamedTuple):
    """C_bm (6, n) of the mode, its singular values, H_norm, and the generalised Jacobian J* (6, n)."""

    C_bm: Array
    sigma: Array
    entropy: float
    J_star: Array


def mode_measures(state: ffsms.State, mode: str) -> ModeMeasures:
    """Return the measures of a state with the C_bm of a mode in place of the floating base's."""
    C_bm = mode_coupling(state.H_b, state.H_bm, mode)
    sigma: Array = np.asarray(np.linalg.svd(C_bm, compute_uv=False), dtype=np.float64)
    shares = sigma[sigma > 0.0] / max(sigma.sum(), 1e-300)
    entropy = float(-(shares * np.log(shares)).sum() / np.log(C_bm.shape[1]))
    return ModeMeasures(C_bm, sigma, entropy, state.J_b @ C_bm + state.J_m)
