"""Test that robots are immutable, and that copies with other limits or inertias can be made."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidInertia, InvalidValue

Refused = Callable[..., FfsmsError]


@pytest.fixture
def robot() -> ffsms.SpaceManipulator:
    return ffsms.load("planar_3r")


def heavier(body: Any, factor: float) -> Any:
    return pin.Inertia(factor * body.mass, body.lever, factor * body.inertia)


@pytest.mark.parametrize(
    "name",
    ["model", "n", "joint_names", "end_effector", "base_size", "limits", "frame_id", "base_com", "colour"],
)
def test_no_attribute_can_be_set(robot: ffsms.SpaceManipulator, name: str) -> None:
    before = getattr(robot, name, None)
    with pytest.raises(AttributeError, match=rf"cannot be changed \(tried to set '{name}'\).*with_limits"):
        setattr(robot, name, before)
    with pytest.raises(AttributeError, match=rf"cannot be changed \(tried to delete '{name}'\)"):
        delattr(robot, name)


def test_returned_arrays_do_not_change_the_robot(robot: ffsms.SpaceManipulator) -> None:
    robot.joint_names.append("another")
    assert len(robot.joint_names) == robot.n
    for array in (robot.base_com, robot.limits.velocity):
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0.0


def test_the_robot_copies_its_model_and_placement(robot: ffsms.SpaceManipulator) -> None:
    model, place = robot.model.copy(), pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    made = ffsms.SpaceManipulator(model, "end_effector", (1.0, 1.0, 1.0), place)
    model.inertias[1] = heavier(model.inertias[1], 3.0)
    place.translation = np.ones(3)
    assert made.model == robot.model
    np.testing.assert_array_equal(made.base_box_placement.translation, [0.1, 0.0, 0.0])


def test_with_limits(robot: ffsms.SpaceManipulator) -> None:
    before = robot.limits
    slower = robot.with_limits(replace(before, velocity=0.5 * before.velocity))
    np.testing.assert_array_equal(slower.limits.velocity, 0.5 * before.velocity)
    assert robot.limits is before
    # Everything else is equal, shapes included.
    assert slower.model == robot.model
    assert slower.base_size == robot.base_size
    assert slower.base_box_placement == robot.base_box_placement
    assert slower.end_effector == robot.end_effector
    assert slower.geometry("visual").ngeoms == robot.geometry("visual").ngeoms


def test_with_inertias(robot: ffsms.SpaceManipulator) -> None:
    narrow = robot.with_limits(replace(robot.limits, torque=np.full(3, 0.25)))
    q, kept = narrow.configuration([0.3, -0.4, 0.5]), narrow.model.copy()
    H = narrow.at(q).H
    inertias = [heavier(body, 2.0) for body in list(narrow.model.inertias)[1:]]
    twice = narrow.with_inertias(inertias)
    np.testing.assert_allclose(twice.at(q).H, 2.0 * H, rtol=1e-13)
    assert narrow.model == kept
    np.testing.assert_array_equal(narrow.at(q).H, H)
    np.testing.assert_array_equal(twice.limits.torque, 0.25)
    assert twice.geometry("visual").ngeoms == narrow.geometry("visual").ngeoms
    # Only the inertias of a model are used.
    model = twice.model.copy()
    model.gravity = pin.Motion(np.full(6, 9.0))
    again = narrow.with_inertias(model)
    assert again.model == twice.model
    # The reference point is the base's centre of mass.
    first = inertias[0]
    moved = narrow.with_inertias(
        [pin.Inertia(first.mass, np.array([0.1, 0.2, 0.3]), first.inertia), *inertias[1:]]
    )
    np.testing.assert_array_equal(moved.base_com, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(narrow.base_com, robot.base_com)


def test_limits_and_inertias_that_do_not_fit_are_refused(
    refused: Refused, robot: ffsms.SpaceManipulator
) -> None:
    seven = ffsms.load("space_arm_7")
    bodies = list(robot.model.inertias)[1:]
    refused(lambda: robot.with_limits(seven.limits), InvalidValue, "limits", "3 joints")
    refused(lambda: robot.with_limits("wide"), InvalidValue, "limits")  # type: ignore[arg-type]
    refused(lambda: robot.with_inertias(seven.model), InvalidValue, "inertias", "same joints")
    refused(lambda: robot.with_inertias(bodies[1:]), InvalidValue, "inertias", "4")
    refused(lambda: robot.with_inertias([1.0, 2.0, 3.0, 4.0]), InvalidValue, "inertias")
    refused(lambda: robot.with_inertias(2.0), InvalidValue, "inertias")
    nothing = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    refused(lambda: robot.with_inertias([*bodies[:-1], nothing]), InvalidInertia, "positive definite")
    refused(
        lambda: ffsms.SpaceManipulator(robot.model, "end_effector", acceleration=1.0, limits=robot.limits),
        InvalidValue,
        "acceleration",
    )


def test_copies_are_equal_and_immutable(robot: ffsms.SpaceManipulator) -> None:
    narrow = robot.with_limits(replace(robot.limits, torque=np.full(3, 0.25)))
    q = narrow.configuration([0.3, -0.4, 0.5])
    for again in (copy.copy(narrow), copy.deepcopy(narrow), pickle.loads(pickle.dumps(narrow))):
        np.testing.assert_array_equal(again.limits.torque, 0.25)
        np.testing.assert_array_equal(again.at(q).H, narrow.at(q).H)
        assert again.base_size == narrow.base_size
        with pytest.raises(AttributeError, match="cannot be changed"):
            again.limits = robot.limits
