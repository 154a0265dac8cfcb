"""Test panels, legends and files of whole figures."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from drawn import curves, dotted, points, quick_run

from ffsms_pin import plotting
from ffsms_pin.plotting.style import legend_above, share_legend, stack
from ffsms_pin.scenarios import Outcome


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return quick_run(tmp_path_factory.mktemp("plotting"))


def test_the_coupling_has_its_singular_values_and_its_entropy(outcome: Outcome) -> None:
    labels = [ax.get_ylabel() for ax in plotting.figure(outcome, "coupling").axes]
    for word in ("cost", "assistance", "entropy", "singular values"):
        assert sum(word in label for label in labels) == 1
    assert [label.startswith("planned ") for label in labels] == [True, True, False, False]


def test_no_panel_of_torques_is_a_flat_line(outcome: Outcome) -> None:
    """Limits near the motion are drawn; otherwise the label has the used share of the limits."""
    share = 100.0 * (np.abs(outcome.tracking.tau) / outcome.controller.torque_limit).max()
    assert share < 20.0
    ax = plotting.figure(outcome, "tracking-torques").axes[1]
    assert not dotted(ax)
    assert f"at most {share:.2g} % of the limits" in ax.get_ylabel()
    tau = outcome.tracking.tau * 0.5 * 100.0 / share
    hard = replace(outcome, tracking=replace(outcome.tracking, tau=tau))
    ax = plotting.figure(hard, "tracking-torques").axes[1]
    near = np.abs(tau).max(axis=0) / outcome.controller.torque_limit > 0.4
    assert dotted(ax) == sorted(
        {sign * limit for limit in outcome.controller.torque_limit[near] for sign in (-1, 1)}
    )
    assert "limits" not in ax.get_ylabel()


def test_a_stop_by_a_guard_is_a_line_in_every_panel_of_the_flight(outcome: Outcome) -> None:
    assert outcome.tracking.stop_time == np.inf
    reason = "stopped at 1.25 s: joint 'joint_1' at its torque limit for 0.3 s (0.02 N m)"
    stopped = replace(outcome, tracking=replace(outcome.tracking, stopped=reason))
    assert stopped.tracking.stop_time == 1.25

    def marks(run: Outcome, name: str) -> list[int]:
        """Return the number of dashed vertical lines at the stop time for each panel."""
        axes = plotting.figure(run, name).axes
        return [
            sum(
                line.get_linestyle() == "--" and np.array_equal(line.get_xdata(), [1.25, 1.25])
                for line in ax.lines
            )
            for ax in axes
        ]

    for name in ("joints", "tracking-joints", "tracking-torques"):
        assert marks(stopped, name) == [1, 1]
        assert marks(outcome, name) == [0, 0]


def test_a_panel_without_labels_has_no_legend() -> None:
    """Matplotlib would warn of an empty legend, and warnings are errors in tests."""
    figure, axes = stack(2)
    for ax in axes:
        ax.plot([0.0, 1.0], [0.0, 1.0])
        legend_above(ax)
        assert ax.get_legend() is None
    share_legend(figure, axes)
    assert not figure.legends


def test_panels_with_equal_labels_share_a_legend(outcome: Outcome) -> None:
    figure = plotting.figure(outcome, "joints")
    assert [ax.get_legend() for ax in figure.axes] == [None, None]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["joint_1", "joint_2", "joint_3", "limits"]
    figure.draw_without_rendering()
    box = legend.get_window_extent()
    assert all(not box.overlaps(ax.get_window_extent()) for ax in figure.axes)
    assert not plotting.figure(outcome, "tracking-torques").legends


@pytest.mark.slow
def test_every_figure_is_written_whole_and_the_same_each_time(outcome: Outcome, tmp_path: Path) -> None:
    # Do not read the backend, because reading it selects a backend.
    before = {key: mpl.rcParams[key] for key in mpl.rcParams if key != "backend"}
    loaded = "matplotlib.pyplot" in sys.modules
    shares: list[float] = []
    kinds = {"pdf": b"%PDF-", "png": b"\x89PNG", "svg": b"<?xml"}
    first = plotting.save_figures(outcome, tmp_path, progress=shares.append)
    assert sorted(tmp_path.iterdir()) == sorted(first)  # no temporary file is left
    names = {f"{name}.{kind}" for name in plotting.FIGURES for kind in ("pdf", "png")}
    assert {path.name for path in first} == names
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    first += plotting.save_formats(plotting.figure(outcome, "motion"), tmp_path / "motion", ("svg",))
    for path in first:
        assert path.read_bytes().startswith(kinds[path.suffix[1:]])
        assert path.stat().st_size > 4_000
    # Drawing changes no global settings.
    assert before == {key: mpl.rcParams[key] for key in before}
    assert ("matplotlib.pyplot" in sys.modules) == loaded
    for name in ("motion", "tracking-torques"):
        (again,) = plotting.save_formats(plotting.figure(outcome, name), tmp_path / "again", ("pdf",))
        assert again.read_bytes() == (tmp_path / f"{name}.pdf").read_bytes()


def test_the_re_planned_run_and_the_run_planned_once_are_drawn(tmp_path: Path) -> None:
    extra = 'reference.kind = "re-planning"\nplant.arm_mass = 1.5\ncontrol.law = "computed-torque"\n'
    outcome = quick_run(tmp_path, extra)
    assert outcome.open_loop is not None
    distance = plotting.figure(outcome, "tracking-torques").axes[0]
    again, once = (points(curve)[:, 1] for curve in curves(distance))
    np.testing.assert_array_equal(again, outcome.tracking.position_error)
    np.testing.assert_array_equal(once, outcome.open_loop.tracking.position_error)
    (drawing,) = plotting.figure(outcome, "motion").axes
    legend = drawing.get_legend()
    assert legend is not None
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels[:3] == ["end effector as planned", "re-planned", "planned once"]
    paths = {str(curve.get_label()): points(curve) for curve in drawing.get_lines()}
    for name, tracking in (
        ("re-planned", outcome.tracking),
        ("planned once", outcome.open_loop.tracking),
    ):
        end = outcome.plant.at(tracking.q[-1]).end_effector_pose.translation
        np.testing.assert_allclose(paths[name][-1], end[:2], atol=1e-12)
