"""Test that texts in figures are complete and separate, and that no quantity is drawn twice."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import points, quick_run, text_faults
from matplotlib.figure import Figure
from scenario_files import CAPTURE, NEARER, write

from ffsms_pin import opt, plotting
from ffsms_pin.control import ComputedTorque
from ffsms_pin.plotting.comparisons import plot_comparison
from ffsms_pin.plotting.figures import figure_names
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios import Outcome, compare, run, scenario
from ffsms_pin.simulation import simulate

COMPLIANT = """kind = "compliant"
stiffness = 500.0
damping = 50.0
turn_stiffness = 20.0
turn_damping = 2.0
time = 0.5
"""


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return quick_run(tmp_path_factory.mktemp("planar"))


@pytest.fixture(scope="module")
def caught(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    text = CAPTURE.replace("after = 4.0", f"{COMPLIANT}after = 2.0")
    return run(scenario(write(tmp_path_factory.mktemp("caught"), text)))


@pytest.fixture(scope="module")
def eight(planar: Outcome, random_tree: Callable[..., Any]) -> Outcome:
    """Return a run of eight joints with long names, some prismatic, and one with a huge rate limit."""
    model = random_tree(3, 8).model()
    for i in range(2, model.njoints):
        model.names[i] = f"shoulder_and_elbow_joint_{i}"
    sms = SpaceManipulator(model, "tip", base_size=(0.6, 0.8, 1.0))
    velocity = sms.limits.velocity.copy()
    velocity[0] = 1e4
    sms = sms.with_limits(replace(sms.limits, velocity=velocity))
    q0 = sms.configuration(np.full(8, 0.3))
    target = sms.at(q0).end_effector_pose.translation + np.array([0.05, -0.05, 0.05])
    plan = opt.plan(sms, q0, target, duration=2.0, dt=0.1, collision="off", method="resolved-rate")
    law = ComputedTorque(sms, K_p=100.0, K_d=20.0)
    tracking = simulate(sms, plan, law, dt=0.01)
    return replace(planar, sms=sms, plant=sms, controller=law, trajectory=plan, tracking=tracking)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar", pytest.param("caught", marks=pytest.mark.long), "eight"])
def test_texts_are_complete_and_separate_and_no_quantity_is_drawn_twice(
    name: str, request: pytest.FixtureRequest
) -> None:
    outcome: Outcome = request.getfixturevalue(name)
    labels: list[str] = []
    for kind in figure_names(outcome):
        figure = plotting.figure(outcome, kind)
        assert text_faults(figure) == [], kind
        panels = itertools.chain(figure.axes, *(part.axes for part in figure.subfigs))
        labels += (
            [] if kind == "motion" else dict.fromkeys(ax.get_ylabel().partition("\n")[0] for ax in panels)
        )
    assert len(labels) == len(set(labels)), labels


def test_cut_off_and_overlapping_texts_are_detected() -> None:
    figure = Figure()
    figure.text(0.5, 0.5, "one")
    assert text_faults(figure) == []
    figure.text(0.51, 0.5, "other")
    figure.text(0.99, 0.1, "beyond the edge")
    assert text_faults(figure) == ["beyond the edge", "one / other"]


def test_prismatic_joints_have_their_own_axis(eight: Outcome) -> None:
    turns = np.array(eight.sms.layout.turns)
    assert 0 < turns.sum() < 8
    ax = plotting.plot_joint_positions(eight.sms, eight.trajectory)
    (right,) = ax.child_axes
    assert (ax.get_ylabel(), right.get_ylabel()) == ("joint position [deg]", "joint position [m]")
    figure = ax.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    lines = [line for line in ax.get_lines() if len(points(line)) > 2]
    ratio = np.ptp(ax.get_ylim()) / np.ptp(right.get_ylim())
    for line, column, turn in zip(lines, eight.trajectory.joint_positions.T, turns, strict=True):
        assert str(line.get_label()).endswith("(right)") is not bool(turn)
        expected = np.degrees(column) if turn else ratio * column
        np.testing.assert_allclose(points(line)[:, 1], expected, rtol=1e-9)
    tallest = [
        max(abs(points(line)[:, 1]).max() for line in itertools.compress(lines, kind))
        for kind in (turns, ~turns)
    ]
    assert tallest[0] == pytest.approx(tallest[1])


def test_a_capture_is_drawn_with_its_phases_and_its_prediction(caught: Outcome) -> None:
    capture = caught.capture
    assert capture is not None
    assert capture.caught
    assert "motion" not in figure_names(caught)  # the figure of the capture has the drawing
    figure = plotting.figure(caught, "capture")
    (drawing,), (states, distance, base, grip) = (part.axes for part in figure.subfigs)
    assert [text.get_text() for text in states.get_yticklabels()] == [phase.name for phase in capture.phases]
    starts = [patch.get_extents().x0 for patch in states.patches]
    marks = states.transData.transform([[phase.time, 0.0] for phase in capture.phases])[:, 0]
    np.testing.assert_allclose(starts, marks)
    texts = {text.get_text() for text in states.texts}
    assert texts == {f"hold point, {capture.phases[1].time:.4g} s", f"contact, {capture.contact_at:.4g} s"}
    assert "distance" in distance.get_ylabel()
    predicted = [points(line) for line in base.get_lines() if line.get_color() == "black"]
    after = predicted[0][:, 0] - capture.contact_at
    expected = np.degrees([capture.planned.rate(t) for t in after])
    np.testing.assert_allclose(np.column_stack([curve[:, 1] for curve in predicted]), expected, atol=1e-12)
    assert points(base.get_lines()[0])[-1, 1] == pytest.approx(np.degrees(capture.found_rate[0]), abs=1e-9)
    assert points(grip.get_lines()[0])[:, 1].max() == pytest.approx(
        np.linalg.norm(capture.whole.contact_wrench[:, :3], axis=1).max(), rel=1e-3
    )
    # A labelled line marks the start of braking, because the force rises there without a new contact.
    (latch,) = grip.texts
    assert latch.get_text().split() == f"latched, {capture.latched_at:.4g} s; braking begins".split()
    ends = [points(line)[:, 0] for line in grip.get_lines() if len(points(line)) == 2]
    assert any((end == capture.latched_at).all() for end in ends)
    # The view is chosen so that the client's outline does not hide the target.
    client = max(
        (patch for patch in drawing.patches if patch.get_alpha() == 0.6), key=lambda patch: patch.get_zorder()
    )
    (target,) = (line for line in drawing.get_lines() if line.get_label() == "target")
    assert not client.get_path().contains_point(points(target)[0])


def test_texts_of_a_comparison_are_complete_and_separate(tmp_path: Path) -> None:
    made = scenario(write(tmp_path, f"{NEARER}[plan]\nduration = 4.0\ndt = 0.05\n"))
    assert text_faults(plot_comparison(compare(made))) == []
