"""Test the drawing of a path in the viewer's scene and in figures, and the distance from it."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
import pytest
from exported import ExportedPage

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.plotting.coupling import plot_position_error
from ffsms_pin.plotting.motion import plot_motion
from ffsms_pin.viewer import view

APPROACH, DURATION = 1.0, 4.0  # [s]


def planned(planar: ffsms.SpaceManipulator, frame: Any) -> opt.Trajectory:
    """Return a plan along a short line that begins at the tool and is fixed in a frame."""
    q0 = planar.configuration([0.4, 0.7, -0.5])
    tool, axes = planar.at(q0).end_effector_pose, pin.SE3.Identity()
    if isinstance(frame, ffsms.Client):
        axes = frame.pose(0.0)
    elif frame == "base":
        axes = pin.XYZQUATToSE3(q0[:7])
    begin = axes.actInv(tool.translation)
    line = opt.Path([begin, begin - [0.03, 0.02, 0.0]], frame=frame, approach_time=APPROACH)
    plan = opt.plan(planar, q0, line, duration=DURATION, dt=0.05)
    assert plan.reached, plan.note
    return plan


@pytest.mark.parametrize("on", ["inertial", "base", "client"])
def test_path_is_drawn_where_it_is(planar: ffsms.SpaceManipulator, on: str) -> None:
    """After the approach the end effector is on the drawn curve; the page has the distance from the path."""
    client = ffsms.Client(20.0, [1.0, 1.0, 1.0], twist=[0.01, 0.0, 0.0, 0.0, 0.0, 0.03])
    plan = planned(planar, client if on == "client" else on)
    opened = ExportedPage(view(planar, plan, fps=10.0).html())
    times, places = opened.track("path", "position")
    _, turns = opened.track("path", "quaternion")
    assert plan.problem is not None
    curve = plan.problem.goal.along(np.linspace(0.0, DURATION - APPROACH, 2001)).positions.T
    for place, turn, t in zip(places, turns, times, strict=True):
        if t < APPROACH:
            continue
        tip = plan.end_effector[int(np.argmin(np.abs(plan.t - t)))]
        drawn = curve @ pin.Quaternion(*turn[[3, 0, 1, 2]]).normalized().toRotationMatrix().T + place
        assert np.linalg.norm(drawn - tip, axis=1).min() < 1e-4
    picture = np.array(opened.facts["seen"]) + opened.facts["centre"]  # points that all cameras include
    drawn = np.vstack([curve, plan.end_effector]) if on == "inertial" else plan.end_effector
    assert (drawn <= picture.max(axis=0) + 1e-4).all()
    assert (drawn >= picture.min(axis=0) - 1e-4).all()
    layers = {layer["name"]: layer["shown"] for layer in opened.facts["layers"]}
    assert layers["path"]
    assert "target" not in layers
    (off,) = [row for row in opened.facts["readings"] if row["label"] == "off the path"]
    assert max(off["values"]) == pytest.approx(1e3 * plan.path_error.max(), rel=0.1)


def test_figures_name_the_path(planar: ffsms.SpaceManipulator) -> None:
    """The figure shows the distance from the path, and the mark is the end of the path."""
    plan = planned(planar, "inertial")
    ax = plot_position_error(plan)
    assert ax.get_ylabel() == "distance from the path [m]"
    assert np.array_equal(ax.lines[0].get_ydata(), plan.path_error)
    legend = plot_motion(planar, plan).get_legend()
    assert legend is not None
    assert "end of the path" in [text.get_text() for text in legend.get_texts()]
    plt.close("all")
