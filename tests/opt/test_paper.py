"""The paper's cost, and the cosine at which it vanishes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ffsms_pin.opt.costs import ideal_cosine, soft_assistance, step_cost

entropies = st.floats(0.0, 1.0)
kappas = st.floats(0.5, 50.0)


@given(st.floats(-1.0, 1.0), entropies, kappas)
def test_cost_is_the_papers_formula(cos_theta: float, entropy: float, kappa: float) -> None:
    C_tilde = math.log(1.0 + math.exp(kappa * cos_theta)) / kappa
    assert soft_assistance(cos_theta, kappa) == pytest.approx(C_tilde, rel=1e-12)
    assert step_cost(cos_theta, entropy, kappa) == pytest.approx((C_tilde - (1.0 - entropy)) ** 2, abs=1e-14)


@given(entropies, kappas)
def test_the_ideal_cosine_is_the_papers_formula(entropy: float, kappa: float) -> None:
    argument = math.exp(kappa * (1.0 - entropy)) - 1.0
    expected = -1.0 if argument <= math.exp(-kappa) else min(1.0, math.log(argument) / kappa)
    # Near zero the difference in the plain formula loses digits.
    if argument > 1e-3:
        assert ideal_cosine(entropy, kappa) == pytest.approx(expected, abs=1e-9)


@given(entropies, st.floats(0.01, 1e6))
def test_the_cost_is_zero_or_least_at_the_ideal_cosine(entropy: float, kappa: float) -> None:
    best = ideal_cosine(entropy, kappa)
    assert -1.0 <= best <= 1.0
    least = step_cost(best, entropy, kappa)
    if -1.0 < best < 1.0:
        assert least < 1e-20
    for cos_theta in np.linspace(-1.0, 1.0, 21):
        assert step_cost(float(cos_theta), entropy, kappa) >= least - 1e-15


@pytest.mark.parametrize("kappa", [15.0, 30.0, 200.0])
@pytest.mark.parametrize("deficit", [1e-8, 1e-11, 1e-14])
def test_the_ideal_cosine_with_an_entropy_near_one(kappa: float, deficit: float) -> None:
    entropy = 1.0 - deficit
    expected = max(-1.0, math.log(math.expm1(kappa * (1.0 - entropy))) / kappa)
    assert ideal_cosine(entropy, kappa) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("kappa", [1e3, 1e4, 1e6])
def test_a_sharp_cone_is_finite(kappa: float) -> None:
    assert soft_assistance(1.0, kappa) == pytest.approx(1.0, abs=1e-12)
    assert soft_assistance(-1.0, kappa) == 0.0
    for entropy in (0.0, 0.3, 0.9):
        assert ideal_cosine(entropy, kappa) == pytest.approx(1.0 - entropy, abs=1e-9)
    assert ideal_cosine(1.0, kappa) == -1.0
