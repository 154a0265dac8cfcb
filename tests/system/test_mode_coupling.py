"""Test the paper's measures in base modes with held directions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mode_measures import mode_measures

import ffsms_pin as ffsms
from ffsms_pin.coupling import decompose, entropy_of_values
from ffsms_pin.errors import InvalidValue

FREE = {
    "rotation-floating": (0, 1, 2),
    "rotation-flying": (0, 1, 2),
    "translation-flying": (3, 4, 5),
    "flying": (),
}


@pytest.fixture(scope="module")
def state() -> ffsms.State:
    sms = ffsms.load("satellite_panda")
    return sms.at(sms.configuration(np.linspace(0.2, 0.9, 7)))


def test_measures_of_the_floating_mode_equal_the_state(state: ffsms.State) -> None:
    measures = mode_measures(state, "floating")
    np.testing.assert_allclose(measures.J_star, state.J_star, atol=1e-12)
    C_bm = np.asarray(-np.linalg.solve(state.H_b, state.H_bm), dtype=np.float64)
    np.testing.assert_allclose(measures.C_bm, C_bm, atol=1e-12)
    assert measures.entropy == pytest.approx(entropy_of_values(decompose(C_bm)[1].tolist(), 7))


@pytest.mark.parametrize("mode", FREE)
def test_held_directions_have_no_coupling(state: ffsms.State, mode: str) -> None:
    measures, free = mode_measures(state, mode), FREE[mode]
    held = [row for row in range(6) if row not in free]
    assert not measures.C_bm[held].any()
    assert np.count_nonzero(measures.sigma > 1e-12) == len(free)
    assert measures.entropy <= math.log(3.0) / math.log(7.0)
    # By the paper's inertia matrix the momentum along the free rows is zero.
    momentum = state.H_b @ measures.C_bm + state.H_bm
    np.testing.assert_allclose(momentum[list(free)], 0.0, atol=1e-12)


def test_a_fully_held_base_has_zero_entropy(state: ffsms.State) -> None:
    measures = mode_measures(state, "flying")
    assert measures.entropy == 0.0
    np.testing.assert_array_equal(measures.J_star, state.J_m)


def test_an_unknown_mode(state: ffsms.State) -> None:
    with pytest.raises(InvalidValue, match="mode"):
        mode_measures(state, "held")
