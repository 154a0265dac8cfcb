"""Test the figure of the wheels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from scenario_files import NEARER, write

from ffsms_pin import plotting
from ffsms_pin.errors import InvalidValue
from ffsms_pin.plotting.figures import figure_names
from ffsms_pin.plotting.series import plot_wheels
from ffsms_pin.scenarios import Outcome, run, scenario, summary

SCENARIO = f"""{NEARER}\
[plan]
duration = 4.0
dt = 0.05
mode = "rotation-floating"
[wheels]
axes = [[1, 0, 1], [-1, 0, 1], [1, 0, 0], [0, 0, 1]]
inertia = 0.001364
torque = 0.5
momentum = [0.1, 0.1, 0.1, 2.0]
[control]
law = "computed-torque"
dt = 0.01
[attitude]
law = "coordinated"
"""


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Return a run of a planar arm whose attitude is held by wheels; one wheel stays at rest."""
    return run(scenario(write(tmp_path_factory.mktemp("wheels"), SCENARIO, "held.toml")))


def named(ax: Axes) -> list[str]:
    return [str(text) for text in ax.get_legend_handles_labels()[1]]


def test_wheels_that_turn_have_a_figure(held: Outcome) -> None:
    names = figure_names(held)
    assert "wheels" in names
    assert "base-angular" not in names  # flat
    assert "base-linear" in names
    momentum, torque, attitude = plotting.figure(held, "wheels").axes
    # Two wheels coincide and share a line; the third, whose axis is in the plane of the arm, is not drawn.
    lines = [line for line in momentum.get_lines() if np.size(line.get_xdata()) > 2]
    assert len(lines) == 2 + 2
    assert [np.size(line.get_xdata()) for line in lines] == [401, 401, 81, 81]
    np.testing.assert_array_equal(lines[0].get_ydata(), held.tracking.wheel_momentum[:, 0])
    np.testing.assert_array_equal(lines[3].get_ydata(), held.trajectory.wheel_momentum[:, 3])
    assert named(momentum)[:2] == ["wheel 1, wheel 2 (coincide)", "wheel 4"]
    assert "planned" in named(momentum)
    assert torque.get_ylabel().startswith("wheel torque [N m]")
    assert attitude.get_ylabel() == "base rotation [deg]"


def test_near_limits_are_drawn_and_far_limits_are_in_the_label(held: Outcome) -> None:
    far = plot_wheels(held.sms, held.trajectory, held.tracking)
    assert held.sms.wheels is not None
    shares = np.abs(held.tracking.wheel_momentum).max(axis=0) / held.sms.wheels.momentum
    assert ("limits" in named(far)) == (shares.max() > 0.4)
    wheels = replace(held.sms.wheels, momentum=1.1 * np.abs(held.tracking.wheel_momentum).max())
    near = plot_wheels(held.sms.with_actuators(wheels=wheels), held.trajectory, held.tracking)
    assert "limits" in named(near)
    assert "% of the limits" not in near.get_ylabel()
    wheels = replace(wheels, momentum=100.0)
    far = plot_wheels(held.sms.with_actuators(wheels=wheels), held.trajectory, held.tracking)
    assert "limits" not in named(far)
    assert "% of the limits" in far.get_ylabel()


def test_wheel_momentum_of_a_plan_is_drawn_alike(held: Outcome) -> None:
    ax = plotting.plot_wheel_momentum(held.sms, held.trajectory)
    assert named(ax)[:2] == ["wheel 1, wheel 2 (coincide)", "wheel 4"]
    np.testing.assert_array_equal(ax.get_lines()[1].get_ydata(), held.trajectory.wheel_momentum[:, 3])
    still = replace(held.trajectory, wheel_momentum=np.zeros_like(held.trajectory.wheel_momentum))
    labels = named(plotting.plot_wheel_momentum(held.sms, still))
    assert labels == ["wheel 1, wheel 2, wheel 3, wheel 4 (coincide)"]


def test_wheels_at_rest_have_no_figure(held: Outcome, tmp_path: Path) -> None:
    path = tmp_path / "free.toml"
    path.write_text(SCENARIO.split("[attitude]", 1)[0].replace('mode = "rotation-floating"\n', ""))
    free = run(scenario(path))
    assert figure_names(free) == list(plotting.FIGURES)
    assert "wheel_energy_J" not in summary(free)
    with pytest.raises(InvalidValue, match="with_actuators"):
        plot_wheels(free.sms.with_actuators(), free.trajectory, free.tracking)


def test_the_summary_has_planned_and_simulated_wheel_values(held: Outcome) -> None:
    numbers = summary(held)
    assert numbers["wheel_energy_J"] == pytest.approx(numbers["tracking"]["wheel_energy_J"], rel=0.01)
    for planned, simulated in zip(numbers["wheels"], numbers["tracking"]["wheels"], strict=True):
        assert planned["name"] == simulated["name"]
        assert planned["momentum_max_Nms"] == pytest.approx(simulated["momentum_max_Nms"], rel=0.01, abs=1e-9)
