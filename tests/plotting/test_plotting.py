"""Test that panels and drawings of a motion show the data of plan and recording with labels."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drawn import curves, dotted, points, quick_run
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from ffsms_pin import opt, plotting
from ffsms_pin.control import ComputedTorque
from ffsms_pin.plotting.series import plot_series
from ffsms_pin.plotting.style import line
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios import Outcome
from ffsms_pin.simulation import simulate

Panel = Callable[[Outcome, Axes | None], Axes]
PANELS: dict[str, Panel] = {
    "joint positions": lambda o, ax: plotting.plot_joint_positions(o.sms, o.trajectory, ax),
    "joint rates": lambda o, ax: plotting.plot_joint_rates(o.sms, o.trajectory, ax),
    "cost": lambda o, ax: plotting.plot_cost(o.trajectory, ax),
    "assistance": lambda o, ax: plotting.plot_assistance(o.trajectory, ax),
    "position error": lambda o, ax: plotting.plot_position_error(o.trajectory, ax),
    "base position": lambda o, ax: plotting.plot_base_position(o.sms, o.trajectory, ax),
    "base velocity": lambda o, ax: plotting.plot_base_velocity(o.sms, o.trajectory, ax),
    "base rotation": lambda o, ax: plotting.plot_base_rotation(o.sms, o.trajectory, ax),
    "base angular velocity": lambda o, ax: plotting.plot_base_angular_velocity(o.sms, o.trajectory, ax),
    "joint error": lambda o, ax: plotting.plot_joint_error(o.sms, o.tracking, ax),
    "joint rate error": lambda o, ax: plotting.plot_joint_rate_error(o.sms, o.tracking, ax),
    "tracked position error": lambda o, ax: plotting.plot_tracked_position_error(o.tracking, ax),
    "torques": lambda o, ax: plotting.plot_torques(o.sms, o.tracking, ax),
    "motion": lambda o, ax: plotting.plot_motion(o.sms, o.trajectory, ax),
}


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return quick_run(tmp_path_factory.mktemp("plotting"))


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_draws_on_the_axes_it_is_given_with_units(outcome: Outcome, name: str) -> None:
    ax = Figure().subplots()
    assert PANELS[name](outcome, ax) is ax
    assert curves(ax)
    for label in (ax.get_xlabel(), ax.get_ylabel()):
        assert "[" in label
        assert "]" in label
    for curve in curves(ax):
        assert np.isfinite(curve.get_xydata()).all()


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_without_axes_makes_its_own_figure(outcome: Outcome, name: str) -> None:
    ax = PANELS[name](outcome, None)
    assert isinstance(ax.figure, Figure)
    assert ax.figure.axes == [ax]


def test_lines_are_the_data(outcome: Outcome) -> None:
    plan, tracking = outcome.trajectory, outcome.tracking
    yaw = np.degrees(2.0 * np.arctan2(plan.q[:, 5], plan.q[:, 6]))
    expected: dict[str, list[Any]] = {
        "joint positions": list(np.degrees(plan.q[:, 7:]).T),
        "joint rates": list(np.degrees(plan.v[:, 6:]).T),
        "cost": [plan.cost],
        "assistance": [plan.cos_theta],
        "position error": [plan.position_error],
        "base position": list(1e3 * (plan.q[:, :3] - plan.q[0, :3]).T),
        "base rotation": [0.0 * yaw, 0.0 * yaw, yaw],
        "joint error": list(np.degrees(tracking.joint_error).T),
        "joint rate error": list(np.degrees(tracking.joint_rate_error).T),
        "tracked position error": [tracking.position_error],
        "torques": list(tracking.tau.T),
    }
    for name, columns in expected.items():
        lines = curves(PANELS[name](outcome, None))
        assert len(lines) == len(columns), name
        for curve, column in zip(lines, columns, strict=True):
            np.testing.assert_allclose(points(curve)[:, 1], column, atol=1e-9, err_msg=name)


def test_velocities_are_the_slopes_of_the_displacements(outcome: Outcome) -> None:
    t = outcome.trajectory.t
    for place, speed in (("base position", "base velocity"), ("base rotation", "base angular velocity")):
        for moved, rate in zip(
            curves(PANELS[place](outcome, None)), curves(PANELS[speed](outcome, None)), strict=True
        ):
            # Integrate by trapezoids with steps of 50 ms.
            slopes, steps = points(rate)[:, 1], np.diff(t)
            summed = np.concatenate([[0.0], np.cumsum(0.5 * steps * (slopes[1:] + slopes[:-1]))])
            np.testing.assert_allclose(summed, points(moved)[:, 1], atol=2e-2 * max(1.0, np.ptp(summed)))


def test_limits_are_dotted_and_in_the_legend(outcome: Outcome) -> None:
    ax = PANELS["joint rates"](outcome, None)
    np.testing.assert_allclose(dotted(ax), [-22.92, 22.92], atol=5e-3)
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["joint_1", "joint_2", "joint_3", "limits"]


def test_torque_limits_are_drawn_on_request(outcome: Outcome) -> None:
    limits = np.array([3.5, 1.5, np.inf])
    ax = plotting.plot_torques(outcome.sms, outcome.tracking, limits=limits)
    assert dotted(ax) == [-3.5, -1.5, 1.5, 3.5]


def test_lines_differ_without_colour() -> None:
    styles = [line(i) for i in range(5)]
    assert len({str(style["linestyle"]) for style in styles}) == 5
    colours = [line(i)["color"] for i in range(7)]
    # The luma of Rec. 709 is the brightness of a colour in a grey print.
    grey = [float(np.array(to_rgb(colour)) @ np.array([0.2126, 0.7152, 0.0722])) for colour in colours]
    for i, j in itertools.combinations(range(7), 2):
        assert abs(grey[i] - grey[j]) > 0.03 or line(i)["linestyle"] != line(j)["linestyle"]


def test_the_drawing_shows_box_arm_path_and_target(outcome: Outcome) -> None:
    ax = plotting.plot_motion(outcome.sms, outcome.trajectory, instants=4)
    assert ax.get_aspect() == 1.0
    boxes = [patch for patch in ax.patches if isinstance(patch, Polygon)]
    assert len(boxes) == 4
    edges = np.linalg.norm(np.diff(boxes[-1].get_xy(), axis=0), axis=1)
    np.testing.assert_allclose(edges, 0.464, atol=1e-12)
    (circle,) = (patch for patch in ax.patches if isinstance(patch, Circle))
    assert circle.center == (0.75, 0.5)
    assert circle.radius == 0.02
    links = [curve for curve in ax.get_lines() if curve.get_linewidth() == 3.0]
    assert len(links) == 4 * 3
    for curve in links:
        assert np.linalg.norm(np.diff(points(curve), axis=0)) == pytest.approx(0.3, abs=1e-12)
    np.testing.assert_allclose(points(links[-1])[-1], outcome.trajectory.end_effector[-1, :2], atol=1e-12)
    strengths = [float(curve.get_alpha() or 1.0) for curve in links[::3]]
    assert strengths == sorted(strengths)
    assert (ax.get_xlabel().split("\n")[0], ax.get_ylabel()) == ("x [m]", "y [m]")


def test_labels_of_a_spatial_motion_state_the_projection(random_tree: Callable[..., Any]) -> None:
    sms = SpaceManipulator(random_tree(3, 5, ("revolute",)).model(), "tip", base_size=(0.6, 0.8, 1.0))
    q0 = sms.configuration(np.full(5, 0.3))
    target = sms.at(q0).end_effector_pose.translation + np.array([0.05, -0.05, 0.05])
    plan = opt.plan(sms, q0, target, duration=2.0, dt=0.1, collision="off")
    ax = plotting.plot_motion(sms, plan)
    assert "projected along" in ax.get_xlabel()
    assert "projected along" in ax.get_ylabel()
    assert any(isinstance(patch, Polygon) for patch in ax.patches)


def test_a_spatial_motion_is_drawn_from_two_sides_at_the_same_scale(
    outcome: Outcome, random_tree: Callable[..., Any]
) -> None:
    sms = SpaceManipulator(random_tree(3, 5, ("revolute",)).model(), "tip", base_size=(0.6, 0.8, 1.0))
    q0 = sms.configuration(np.full(5, 0.3))
    target = sms.at(q0).end_effector_pose.translation + np.array([0.05, -0.05, 0.05])
    plan = opt.plan(sms, q0, target, duration=2.0, dt=0.1, collision="off")
    sides = plotting.motion_sides(sms, plan)
    assert len(set(sides)) == 2
    tracking = simulate(sms, plan, ComputedTorque(sms, K_p=100.0, K_d=20.0), dt=0.05)
    spatial = replace(outcome, sms=sms, plant=sms, trajectory=plan, tracking=tracking)
    figure = plotting.figure(spatial, "motion")
    figure.draw_without_rendering()
    scales = []
    for ax, side in zip(figure.axes, sides, strict=True):
        assert f"projected along {side}" in ax.get_xlabel()
        shown = ["xyz".index(ax.get_xlabel()[0]), "xyz".index(ax.get_ylabel()[0])]
        assert "xyz".index(side) not in shown
        path = next(points(curve) for curve in ax.get_lines() if curve.get_linestyle() == "--")
        np.testing.assert_allclose(path, plan.end_effector[:, shown], atol=1e-12)
        assert ax.get_legend() is None  # both axes share a legend
        scales.append(ax.get_window_extent().height / np.ptp(ax.get_ylim()))
    assert len(figure.legends) == 1
    assert scales[0] == pytest.approx(scales[1], rel=0.05)
    assert plotting.motion_sides(outcome.sms, outcome.trajectory) == ("z",)


def test_a_cost_that_spans_decades_has_a_logarithmic_scale(outcome: Outcome) -> None:
    plan = outcome.trajectory
    steps = np.linspace(0.0, 1.0, len(plan.cost))
    for cost, scale in ((1.0 + steps, "linear"), (10.0 ** (-6.0 * steps), "log"), (0.0 * steps, "linear")):
        ax = plotting.plot_cost(replace(plan, cost=cost))
        assert ax.get_yscale() == scale
        low, high = ax.get_ylim()
        assert low < np.quantile(cost, 0.1)
        assert high > cost.max()
    peak = np.where(steps > 0.95, 1.0, 0.0)  # most values are zero
    assert plotting.plot_cost(replace(plan, cost=peak)).get_ylim()[0] > 0.0


def test_long_names_stay_within_the_figure() -> None:
    t, names = np.linspace(0.0, 1.0, 5), [f"shoulder_and_elbow_joint_{i}" for i in range(9)]
    for count in (1, 3, 9):
        limit = np.arange(1.0, 1.0 + count)
        ax = plot_series(None, t, np.outer(t, limit), "value [-]", names[:count], (limit,))
        figure = ax.figure
        assert isinstance(figure, Figure)
        figure.draw_without_rendering()
        legend = ax.get_legend()
        assert legend is not None
        box = legend.get_window_extent()
        assert box.x0 >= 0.0
        assert box.y1 <= figure.bbox.height
        assert ax.get_window_extent().width > 0.5 * figure.bbox.width  # the panel keeps its size


def test_lines_that_coincide_share_an_entry_of_the_legend() -> None:
    t = np.linspace(0.0, 1.0, 5)
    ax = plot_series(None, t, np.column_stack([0.0 * t, 1e-6 * t, t]), "base rotation [deg]", "xyz")
    assert len(ax.get_lines()) == 3
    assert ax.get_legend_handles_labels()[1] == ["x, y (coincide)", "z"]
    apart = plot_series(None, t, np.column_stack([t, np.inf * np.ones(5), 0.9 * t]), "rate [deg/s]", "xyz")
    assert apart.get_legend_handles_labels()[1] == ["x", "y", "z"]


def test_a_motion_is_drawn_at_a_single_instant(outcome: Outcome) -> None:
    ax = plotting.plot_motion(outcome.sms, outcome.trajectory, instants=[outcome.trajectory.duration])
    assert len(ax.get_lines()) > 0


def test_runs_of_different_length_are_drawn_side_by_side(outcome: Outcome) -> None:
    whole = outcome.tracking
    early = whole.between(0.0, 0.5 * float(whole.t[-1]))
    for first, second in ((whole, early), (early, whole)):
        ax = plotting.plot_tracked_position_error(first, open_loop=second)
        assert max(np.asarray(curve.get_xdata()).max() for curve in ax.get_lines()) == pytest.approx(
            whole.t[-1]
        )
