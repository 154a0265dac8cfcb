"""The paper's cost, and the cone on which it vanishes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import cosine, cosine_of_triples
from ffsms_pin.opt import ideal_cosine, soft_assistance, step_cost
from ffsms_pin.opt.cone import Triple, cone_direction, lateral_direction


def triple(vector: FloatArray) -> Triple:
    x, y, z = vector.tolist()
    return x, y, z


entropies = st.floats(0.0, 1.0)
kappas = st.floats(0.5, 50.0)


@given(st.floats(-1.0, 1.0), entropies, kappas)
def test_cost_is_the_papers_formula(cos_theta: float, entropy: float, kappa: float) -> None:
    C_tilde = math.log(1.0 + math.exp(kappa * cos_theta)) / kappa
    assert soft_assistance(cos_theta, kappa) == pytest.approx(C_tilde, rel=1e-12)
    assert step_cost(cos_theta, entropy, kappa) == pytest.approx((C_tilde - (1.0 - entropy)) ** 2, abs=1e-14)


@given(entropies, kappas)
def test_cost_vanishes_at_the_ideal_cosine_or_is_least_there(entropy: float, kappa: float) -> None:
    best = ideal_cosine(entropy, kappa)
    assert -1.0 <= best <= 1.0
    least = step_cost(best, entropy, kappa)
    if -1.0 < best < 1.0:
        assert least < 1e-20
    for cos_theta in np.linspace(-1.0, 1.0, 21):
        assert step_cost(float(cos_theta), entropy, kappa) >= least - 1e-15


@given(st.integers(0, 2**32 - 1), st.floats(-1.0, 1.0))
def test_cone_direction_has_the_asked_angle_and_side(seed: int, cos_theta: float) -> None:
    rng = np.random.default_rng(seed)
    towards = rng.normal(size=3)
    towards /= np.linalg.norm(towards)
    hint = rng.normal(size=3)
    lateral = np.array(lateral_direction(triple(towards), triple(hint)))
    e = np.array(cone_direction(triple(towards), triple(lateral), cos_theta))
    assert np.linalg.norm(e) == pytest.approx(1.0)
    assert e @ towards == pytest.approx(cos_theta, abs=1e-12)
    assert lateral @ hint >= 0.0


def test_lateral_direction_exists_where_the_hint_gives_none() -> None:
    towards = np.array([0.0, 0.0, 1.0])
    for hint in (np.zeros(3), 5.0 * towards):
        lateral = np.array(lateral_direction(triple(towards), triple(hint)))
        assert np.linalg.norm(lateral) == pytest.approx(1.0)
        assert abs(lateral @ towards) < 1e-12


@given(st.integers(0, 2**32 - 1))
def test_triples_give_what_arrays_give(seed: int) -> None:
    rng = np.random.default_rng(seed)
    towards, hint = rng.normal(size=3), rng.normal(size=3)
    towards /= np.linalg.norm(towards)
    across = hint - (hint @ towards) * towards
    expected = across / np.linalg.norm(across)
    np.testing.assert_allclose(lateral_direction(triple(towards), triple(hint)), expected, atol=1e-12)
    cosine_expected = hint @ towards / np.linalg.norm(hint)
    assert cosine(hint, towards) == pytest.approx(cosine_expected, abs=1e-14)
    assert cosine_of_triples(triple(hint), triple(towards)) == cosine(hint, towards)


def test_the_soft_assistance_of_a_sharp_cone_is_finite() -> None:
    assert soft_assistance(1.0, 1e4) == pytest.approx(1.0, abs=1e-12)
    assert soft_assistance(-1.0, 1e4) == 0.0
