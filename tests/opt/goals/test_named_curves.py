"""The curves line, circle, helix and rounded square, and the attitudes along them."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError
from ffsms_pin.opt.goals.curves import TimeLaw
from ffsms_pin.opt.goals.path_files import path_samples

AXES = pin.SE3(pin.utils.rotate("x", 0.4), np.array([0.1, 0.2, 0.3]))


def test_a_curve_lies_in_its_axes() -> None:
    assert np.allclose(opt.Line([0.1, 0.0, 0.2], axes=AXES)(0.5), AXES.act(np.array([0.05, 0.0, 0.1])))
    circle = opt.Circle(0.2, turns=-0.5, axes=AXES.homogeneous)
    assert np.allclose(circle(0.5), AXES.act(np.array([0.0, -0.2, 0.0])))
    assert np.allclose(opt.Helix(0.2, 0.4)(1.0), [0.2, 0.0, 0.2])
    assert np.allclose(opt.RoundedSquare(0.4, 0.1)(0.25), [0.0, 0.2, 0.0])


@pytest.mark.parametrize(("faces", "flat"), [("axis", [1.0, 1.0, 0.0]), ("centre", [1.0, 1.0, 1.0])])
def test_the_tool_axis_faces_the_axis_or_the_centre(faces: str, flat: list[float]) -> None:
    axis = np.array([1.0, 0.0, 0.0])
    curve = opt.Helix(0.5, 0.4, axes=AXES, faces=faces, tool_axis=axis)  # type: ignore[arg-type]
    for s in (0.0, 0.3, 1.0):
        pose = AXES.actInv(curve(s))
        inwards = -pose.translation * flat
        assert np.allclose(pose.rotation @ axis, inwards / np.linalg.norm(inwards))


def test_a_path_along_a_curve_needs_no_parameter(planar: ffsms.SpaceManipulator) -> None:
    """The parameter of a named curve runs from 0 to 1; a pickled curve gives the same points."""
    curve = opt.Circle(0.02)
    path = opt.Path(curve, timing="fastest")
    assert path.geometric
    assert path.parameter == (0.0, 1.0)
    again = pickle.loads(pickle.dumps(curve))
    assert np.array_equal(again(0.3), curve(0.3))
    q0 = planar.configuration([0.4, 0.7, -0.5])
    start = planar.at(q0).end_effector_pose * pin.SE3(np.eye(3), np.array([-0.02, 0.0, 0.0]))
    problem = opt.Problem(planar, q0, opt.Path(opt.Circle(0.02, axes=start)), duration=4.0, dt=0.05)
    assert np.allclose(problem.goal.place(0.0).position, planar.at(q0).end_effector_pose.translation)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: opt.RoundedSquare(0.2, 0.15), "corner must be at most half of the side"),
        (lambda: opt.Circle(-0.1), "radius must be above zero"),
        (lambda: opt.Line([0.1]), "end must have shape"),
        (
            lambda: opt.Circle(0.1, faces="outwards"),  # type: ignore[arg-type]
            'faces must be "axis" or "centre"',
        ),
        (lambda: opt.Circle(0.1, faces="axis", attitude=np.eye(3)), "faces and attitude both"),
        (
            lambda: opt.Line([0.1, 0.0, 0.0], faces="axis")(0.0),
            "faces needs a curve that never meets the axis",
        ),
    ],
)
def test_wrong_arguments_of_curves_are_refused(
    make: Callable[[], object], message: str, refused: Callable[..., FfsmsError]
) -> None:
    refused(make, InvalidValue, message)


def test_a_slower_law_covers_the_same_shares_later() -> None:
    law = TimeLaw(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.4, 1.0]), np.array([0.0, 0.5, 0.1]))
    t = np.linspace(0.0, 3.0, 13)
    np.testing.assert_allclose(law.slower(2.0)(2.0 * t), law(t), rtol=0.0, atol=1e-14)


def test_an_empty_file_of_samples_is_reported(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_text(" \n")
    with pytest.raises(ResultError, match=r"empty\.csv: is empty"):
        path_samples(tmp_path / "empty.csv")
