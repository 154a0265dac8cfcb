"""Joint rates as a B-spline: its maps, its control points, and finer splines."""

from __future__ import annotations

import numpy as np
import pytest
from horizon_parts import COARSE, TINY, integrated
from scipy.integrate import quad

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.search.spline import Grid, Map, RateSpline, embedded, rate_spline


@pytest.mark.parametrize("free_end", [False, True])
@pytest.mark.parametrize("rate0", [0.0, 0.7])
def test_maps_of_the_spline(free_end: bool, rate0: float, rng: np.random.Generator) -> None:
    spline = rate_spline(300, 0.02, COARSE, free_end)
    p, start = rng.normal(size=(spline.size, 1)), np.array([rate0])

    def values(map_: Map) -> FloatArray:
        return map_.of(p, start)[:, 0]

    def rate(t: float) -> float:
        return float(values(spline.rates_at(np.array([t])))[0])

    borders = np.unique(spline.knots)
    for time, travel in zip(spline.times, values(spline.travel), strict=True):
        expected = quad(rate, 0.0, time, points=borders[borders < time], limit=200)[0]
        assert travel == pytest.approx(expected, abs=1e-8)
    np.testing.assert_allclose(values(spline.rates), values(spline.rates_at(spline.times)), atol=1e-12)
    h = 1e-6
    inside = np.array([np.abs(borders - t).min() > 1e-4 for t in spline.times])
    ahead, behind = (values(spline.rates_at(spline.times + d)) for d in (h, -h))
    slopes = ((ahead - behind) / (2.0 * h))[inside]
    np.testing.assert_allclose(values(spline.accelerations)[inside], slopes, atol=1e-6)
    assert values(spline.rates)[-1] == pytest.approx(rate(6.0), abs=1e-12)

    # Control points bound the curves at every instant.
    t = np.linspace(0.0, borders[-1], 20001)
    rates = values(spline.rates_at(t))
    assert rates[0] == rate0
    assert (rates[-1] == 0.0) is not free_end
    acceleration = np.diff(rates) / np.diff(t)
    assert np.abs(rates).max() <= max(np.abs(values(spline.rate_points)).max(), abs(rate0)) + 1e-12
    assert np.abs(acceleration).max() <= np.abs(values(spline.acceleration_points)).max() + 1e-9
    places = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (rates[1:] + rates[:-1]))])
    assert places.max() <= max(0.0, float(values(spline.position_points).max())) + 1e-6
    assert places.min() >= min(0.0, float(values(spline.position_points).min())) - 1e-6
    # The last position point is the end of the motion.
    assert values(spline.position_points)[-1] == pytest.approx(places[-1], abs=1e-6)
    if rate0 == 0.0:
        squares = float((p.T @ spline.squared_acceleration @ p)[0, 0])
        assert np.sum(acceleration**2 * np.diff(t)) == pytest.approx(squares, rel=1e-3)


def test_the_quadrature_integrates() -> None:
    spline = rate_spline(300, 0.02, COARSE)
    assert spline.weights.sum() == pytest.approx(6.0)
    count = len(spline.weights) - 2
    np.testing.assert_allclose(spline.times[count:], [5.4, 6.0])
    late = spline.quadrature[2] * COARSE.gauss
    assert spline.times[late] > 5.4 > spline.times[late - 1]
    np.testing.assert_array_equal(spline.last_tenth, [*range(late, count), count])
    np.testing.assert_allclose(integrated(spline, spline.times**2), spline.times**3 / 3.0, atol=0.02)
    np.testing.assert_allclose(integrated(spline, spline.times), spline.times**2 / 2.0, atol=1e-12)
    # The last step counts at the deadline, as in the paper's sum; limits watch 0.9 T and the deadline.
    np.testing.assert_allclose(spline.weights[count:], [0.0, 0.02])
    assert not spline.weights[:count][spline.times[:count] > 5.98].any()
    np.testing.assert_array_equal(spline.limit_weights[count:], [6.0, 6.0])


@pytest.mark.parametrize("free_end", [False, True])
def test_a_finer_spline_agrees_at_its_sites(free_end: bool, rng: np.random.Generator) -> None:
    coarse, fine = (rate_spline(300, 0.02, grid, free_end) for grid in (COARSE, Grid(12, 5, 3)))
    p, rates0 = rng.normal(size=(2, coarse.size, 3)), rng.normal(size=3)
    embedded_points = embedded(coarse, fine, p, rates0)
    assert embedded_points.shape == (2, fine.size, 3)
    np.testing.assert_allclose(
        fine.rates_at(fine.sites).of(embedded_points, rates0),
        coarse.rates_at(fine.sites).of(p, rates0),
        atol=1e-10,
    )
    # Embedding in the same spline is the identity.
    np.testing.assert_allclose(embedded(coarse, coarse, p, rates0), p, atol=1e-10)


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_few_steps_are_enough(steps: int) -> None:
    spline = rate_spline(steps, 0.5, TINY)
    assert isinstance(spline, RateSpline)
    assert np.isfinite(spline.rates.free).all()
    assert spline.weights.sum() == pytest.approx(0.5 * steps)
    assert np.linalg.matrix_rank(spline.at_sites.free) == spline.size
