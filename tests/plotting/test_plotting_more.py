"""Test figures of the coupling over time, of its map, and of bands of runs."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting import (
    entropy_grid,
    plot_bands,
    plot_entropy,
    plot_entropy_map,
    plot_error_bands,
    plot_series,
    plot_sigma_bands,
)
from ffsms_pin.simulation.plant import random_plants


@pytest.fixture(scope="module")
def plan(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.plan(planar, q0, [1.0, 0.15, 0.0], duration=6.0, dt=0.05)


@pytest.fixture(scope="module")
def runs(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> list[ffsms.Tracking]:
    controller = ffsms.SlidingModeController(planar)
    plants = random_plants(planar, np.random.default_rng(0), 5)
    return [ffsms.simulate(planar, plan, controller, dt=0.01, plant=plant) for plant in plants]


def _figure(ax: Axes) -> Figure:
    figure = ax.get_figure()
    assert isinstance(figure, Figure)
    return figure


def test_bands_of_sigma_are_as_wide_as_the_singular_values(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    ax = plot_sigma_bands(planar, plan)
    middle = len(plan.t) // 2
    expected = np.linalg.svd(planar.at(plan.q[middle]).C_bm, compute_uv=False)
    lines = [np.array(line.get_data(), dtype=np.float64) for line in ax.get_lines()[:3]]
    edges = [float(np.interp(plan.t[middle], t, values)) for t, values in lines]
    np.testing.assert_allclose(np.diff([0.0, *edges]), expected, atol=1e-9)
    assert "m/rad" in ax.get_ylabel()
    assert ax.get_xlabel() == "time [s]"


def test_entropy_is_drawn_as_planned(plan: opt.Trajectory) -> None:
    ax = Figure().subplots()
    assert plot_entropy(plan, ax) is ax
    (line,) = ax.get_lines()
    np.testing.assert_array_equal(line.get_ydata(), plan.entropy)


def test_map_has_the_entropy_of_each_posture(planar: ffsms.SpaceManipulator) -> None:
    first, second, entropy = entropy_grid(planar, (1, 2), at=[0.3, 0.0, 0.0], points=5)
    assert first[0] == planar.limits.lower[1]
    assert second[-1] == planar.limits.upper[2]
    # Compute the entropy of a posture of the map by NumPy.
    state = planar.at(planar.configuration([0.3, first[3], second[1]]))
    sigma = np.linalg.svd(-np.linalg.solve(state.H_b, state.H_bm), compute_uv=False)
    share = sigma[sigma > 1e-14] / sigma.sum()
    assert entropy[1, 3] == pytest.approx(-float((share * np.log(share)).sum()) / np.log(3.0), abs=1e-9)


def test_map_is_labelled_and_can_be_written_as_vectors(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    ax = plot_entropy_map(planar, (1, 2), points=7, trajectory=plan)
    assert ax.get_xlabel() == "joint_2 [deg]"
    assert ax.get_ylabel() == "joint_3 [deg]"
    file = io.BytesIO()
    _figure(ax).savefig(file, format="svg")
    assert b"<image" not in file.getvalue()


def test_band_contains_its_share_of_the_runs() -> None:
    t = np.linspace(0.0, 1.0, 4)
    runs = np.arange(101.0)[:, None] * np.ones(4)
    ax = plot_bands(t, runs, "value [-]", share=0.8)
    band = ax.collections[0]
    assert isinstance(band, PolyCollection)
    heights = np.array(band.get_paths()[0].vertices, dtype=np.float64)[:, 1]
    np.testing.assert_allclose([heights.min(), heights.max()], [10.0, 90.0])
    (middle,) = ax.get_lines()
    np.testing.assert_array_equal(middle.get_ydata(), np.full(4, 50.0))
    legend = ax.get_legend()
    assert legend is not None
    assert "80 % of 101 runs" in [text.get_text() for text in legend.get_texts()]


def test_a_band_has_gaps_where_runs_are_infinite() -> None:
    runs = np.array([[1.0, 1.0, 1.0], [1.0, 2.0, -np.inf]])
    (median,) = plot_bands(np.arange(3.0), runs, "value [-]").lines
    np.testing.assert_array_equal(np.isfinite(median.get_ydata()), [True, True, False])


def test_error_bands_have_the_median_of_the_runs(runs: list[ffsms.Tracking]) -> None:
    ax = plot_error_bands(runs, reach=0.02)
    assert ax.get_ylabel() == "distance to target [m]"
    median = np.median([run.position_error for run in runs], axis=0)
    np.testing.assert_allclose(np.array(ax.get_lines()[0].get_ydata(), dtype=np.float64), median)
    shifted = replace(runs[1], t=runs[1].t + 0.5)
    with pytest.raises(InvalidValue, match="same instants"):
        plot_error_bands([runs[0], shifted])


def test_lines_without_a_name_have_no_label() -> None:
    ax = plot_series(None, np.arange(3.0), np.ones((3, 2)), "value [-]", ["first"])
    labels = [str(line.get_label())[:1] for line in ax.get_lines()]
    assert labels == ["f", "_"]  # matplotlib hides labels that begin with "_"
