"""Test figures of a run with plan and flight, limits near the motion, and logarithmic scales."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import text_faults
from matplotlib.axes import Axes
from scenario_files import QUICK, write

from ffsms_pin import plotting
from ffsms_pin.plotting.style import AS_PLANNED, PLANNED, _columns
from ffsms_pin.scenarios import Outcome, run, scenario


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run(scenario(write(tmp_path_factory.mktemp("quick"), QUICK.replace("offset_deg", "# offset_deg"))))


def other_flight(outcome: Outcome) -> Outcome:
    """Return the run with a recording that ends 30 degrees off at all joints and 3 degrees at the base."""
    q = outcome.tracking.q.copy()
    share = np.linspace(0.0, 1.0, len(q))
    q[:, 7:] += np.radians(30.0) * share[:, None]
    turn = 2.0 * np.arctan2(q[:, 5], q[:, 6]) + np.radians(3.0) * share
    q[:, 5], q[:, 6] = np.sin(0.5 * turn), np.cos(0.5 * turn)
    return replace(outcome, tracking=replace(outcome.tracking, q=q))


def labels(ax: Axes) -> list[str]:
    return list(ax.get_legend_handles_labels()[1])


def thin(ax: Axes) -> list[Any]:
    """Return the data of the thin lines, which show the plan."""
    return [
        np.asarray(line.get_ydata())
        for line in ax.get_lines()
        if line.get_linewidth() == PLANNED["linewidth"] and len(np.asarray(line.get_ydata())) > 2
    ]


def test_the_flight_is_drawn_if_it_differs_from_the_plan(outcome: Outcome) -> None:
    for made, differs in ((outcome, False), (other_flight(outcome), True)):
        for name, panel, values in (
            ("joints", 0, np.degrees(outcome.trajectory.q[:, 7:])),
            ("base-angular", 0, None),
        ):
            ax = plotting.figure(made, name).axes[panel]
            assert (AS_PLANNED in labels(ax)) is differs, name
            assert len(thin(ax)) == (3 if differs else 0)
            if differs and values is not None:
                np.testing.assert_allclose(np.array(thin(ax)).T, values, atol=1e-9)
                drawn = np.asarray(ax.get_lines()[0].get_ydata())
                assert drawn[-1] == pytest.approx(np.degrees(made.tracking.q[-1, 7]))
        for panel in (2, 3):  # entropy and singular values
            ax = plotting.figure(made, "coupling").axes[panel]
            assert (AS_PLANNED in labels(ax)) is differs


def test_only_limits_near_the_motion_are_drawn(outcome: Outcome) -> None:
    def dotted(ax: Axes) -> list[float]:
        lines = [line for line in ax.get_lines() if line.get_linestyle() == ":"]
        return sorted(
            {float(np.asarray(line.get_ydata())[0]) for line in lines if len(np.asarray(line.get_ydata()))}
        )

    tight = outcome.sms.limits
    sms = outcome.sms.with_limits(replace(tight, lower=tight.lower - 3.0, upper=tight.upper + 3.0))
    positions = plotting.figure(replace(outcome, sms=sms), "joints").axes[0]
    assert dotted(positions) == []
    upper = sms.limits.upper.copy()
    upper[1] = outcome.trajectory.q[:, 8].max() + 0.01
    near = sms.with_limits(replace(sms.limits, upper=upper))
    positions = plotting.figure(replace(outcome, sms=near), "joints").axes[0]
    np.testing.assert_allclose(dotted(positions), [np.degrees(upper[1])])

    fast = sms.with_limits(replace(sms.limits, velocity=10.0 * sms.limits.velocity))
    rates = plotting.figure(replace(outcome, sms=fast), "joints").axes[1]
    assert dotted(rates) == []
    share = 10.0 * float((np.abs(outcome.trajectory.v[:, 6:]) / sms.limits.velocity).max())
    assert f"at most {share:.2g} % of the limits" in rates.get_ylabel()


def test_singular_values_that_span_decades_can_all_be_read(outcome: Outcome) -> None:
    ax = plotting.figure(outcome, "coupling").axes[3]
    assert ax.get_yscale() == "log"  # singular values of the planar arm are about 0.3 and 0.003
    low, high = ax.get_ylim()
    sigma = np.array([outcome.sms.at(q).coupling.sigma for q in outcome.trajectory.q])
    assert len(ax.get_lines()) == 3
    assert low < sigma.min()
    assert sigma.max() < high
    for curve, column in zip(ax.get_lines(), sigma.T, strict=True):
        np.testing.assert_allclose(np.asarray(curve.get_ydata()), column, rtol=1e-12)


def test_legends_have_the_columns_that_fit() -> None:
    assert _columns(["x", "y", "z", AS_PLANNED]) == 4
    assert _columns([f"panda_joint{i}" for i in range(1, 8)]) == 3
    assert _columns(["a" * 100, "b"]) == 1
    seven = [f"joint_{i}" for i in range(1, 8)]
    assert _columns(seven) == 4  # two rows of up to four columns
    figure = plotting.plot_series(None, np.arange(2.0), np.zeros((2, 7)), "torque", seven).get_figure(
        root=True
    )
    assert figure is not None
    assert text_faults(figure) == []


def test_a_figure_of_two_sides_lists_its_times_once(outcome: Outcome, tmp_path: Path) -> None:
    turned = outcome.trajectory.q.copy()
    turned[:, 2] += np.linspace(0.0, 0.2, len(turned))  # out of the plane
    spatial = replace(outcome, trajectory=replace(outcome.trajectory, q=turned))
    figure = plotting.figure(spatial, "motion")
    assert len(figure.axes) == 2
    assert all("t = " not in ax.get_xlabel() for ax in figure.axes)
    text = figure.get_supxlabel()
    assert "t = 0, " in text
    figure.draw_without_rendering()
    inside = figure.bbox
    for ax in figure.axes:
        box = ax.xaxis.label.get_window_extent()
        assert inside.x0 <= box.x0
        assert box.x1 <= inside.x1
