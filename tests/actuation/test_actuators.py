"""Wheels and thrusters as values, and the model in which wheels are joints."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.actuation import gyrostat
from ffsms_pin.errors import FfsmsError, InvalidValue

Refused = Callable[..., FfsmsError]
PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]


def test_axes_become_unit_vectors_and_numbers_one_a_wheel() -> None:
    wheels = ffsms.ReactionWheels(PYRAMID, 1e-3, 0.1, [1.0, 2.0, 3.0, np.inf])
    np.testing.assert_allclose(np.linalg.norm(wheels.axes, axis=1), 1.0)
    np.testing.assert_array_equal(wheels.inertia, np.full(4, 1e-3))
    assert wheels.names[3] == "wheel 4"
    for array in (wheels.axes, wheels.momentum):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    one = ffsms.ReactionWheels([0, 0, 2], 1e-3)
    np.testing.assert_array_equal(one.axes, [[0.0, 0.0, 1.0]])
    assert len(one) == 1


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"axes": [[0, 0, 0]], "inertia": 1.0}, ["wheels.axes", "length zero"]),
        ({"axes": PYRAMID, "inertia": 0.0}, ["wheels.inertia", "above zero [kg m^2]"]),
        ({"axes": PYRAMID, "inertia": [1.0, 2.0]}, ["wheels.inertia", "(4,)"]),
        ({"axes": PYRAMID, "inertia": 1.0, "torque": -1.0}, ["wheels.torque", "N m"]),
        ({"axes": PYRAMID, "inertia": 1.0, "names": ["a"]}, ["wheels.names", "4 names"]),
    ],
)
def test_wheels_that_cannot_be(refused: Refused, keywords: dict[str, object], words: list[str]) -> None:
    refused(lambda: ffsms.ReactionWheels(**keywords), InvalidValue, *words)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"directions": [[1, 0, 0]]}, ["thrusters.directions", "2 rows"]),
        ({"least_on_time": 0.0}, ["thrusters.period"]),
        ({"period": 0.01}, ["thrusters.period", "least_on_time"]),
        ({"specific_impulse": 0.0}, ["thrusters.specific_impulse", "[s]"]),
    ],
)
def test_thrusters_that_cannot_be(refused: Refused, keywords: dict[str, object], words: list[str]) -> None:
    good: dict[str, object] = {
        "places": [[0, 1, 0], [0, -1, 0]],
        "directions": [[1, 0, 0], [1, 0, 0]],
        "force": 1.0,
        "least_on_time": 0.02,
    }
    ffsms.Thrusters(**good)  # type: ignore[arg-type]
    refused(lambda: ffsms.Thrusters(**{**good, **keywords}), InvalidValue, *words)  # type: ignore[arg-type]


def test_a_thruster_pushes_and_turns_about_the_root(rng: np.random.Generator) -> None:
    places, ways = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    thrusters = ffsms.Thrusters(places, ways, 2.0, proportional=True, specific_impulse=200.0)
    force = rng.uniform(0.0, 2.0, 5)
    pushes = [f * way / np.linalg.norm(way) for f, way in zip(force, ways, strict=True)]
    moments = [np.cross(place, push) for place, push in zip(places, pushes, strict=True)]
    expected = np.concatenate([np.sum(pushes, axis=0), np.sum(moments, axis=0)])
    np.testing.assert_allclose(thrusters.wrenches @ force, expected, rtol=1e-13)
    assert thrusters.flow(force) == pytest.approx(force.sum() / (200.0 * 9.80665))


def test_actuators_stay_with_a_robot_and_change_nothing_of_it(planar: ffsms.SpaceManipulator) -> None:
    wheels, thrusters = (
        ffsms.ReactionWheels(np.eye(3), 1e-3),
        ffsms.Thrusters([1, 0, 0], [0, 1, 0], 1.0, proportional=True),
    )
    robot = planar.with_actuators(wheels=wheels, thrusters=thrusters)
    assert planar.wheels is None
    for made in (robot, robot.with_limits(robot.limits), robot.with_inertias(robot.model)):
        assert made.wheels is wheels
        assert made.thrusters is thrusters
    copied = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(copied.wheels.axes, wheels.axes)
    assert robot.with_actuators(thrusters=thrusters).wheels is None
    assert (robot.n, robot.joint_names) == (planar.n, planar.joint_names)
    q, v = planar.configuration([0.1, 0.2, 0.3]), np.arange(9.0) / 10.0
    one, other = robot.at(q, v), planar.at(q, v)
    for name in ("C_bm", "H", "J_star", "momentum"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.coupling.entropy == other.coupling.entropy
    with pytest.raises(AttributeError, match="with_actuators"):
        robot.wheels = None


def test_wheels_heavier_than_their_satellite(planar: ffsms.SpaceManipulator, refused: Refused) -> None:
    refused(
        lambda: planar.with_actuators(wheels=ffsms.ReactionWheels(np.eye(3), 1.12)),
        InvalidValue,
        "wheels.inertia",
        "includes the wheels",
    )
    refused(lambda: planar.with_actuators(wheels=3), InvalidValue, "wheels", "ReactionWheels")  # type: ignore[arg-type]


def test_a_wheel_is_a_gyrostat(rng: np.random.Generator) -> None:
    """Euler's equations of a base with wheels, written out: J w' + w x (J w + a h) = -a tau, h' = tau."""
    axes, inertia = rng.normal(size=(4, 3)), rng.uniform(0.01, 0.05, 4)
    wheels = ffsms.ReactionWheels(axes, inertia)
    tensor = np.diag([3.0, 4.0, 5.0]) + 0.1
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    model.inertias[1] = pin.Inertia(50.0, np.zeros(3), tensor)
    model.gravity = pin.Motion.Zero()
    whole = gyrostat(model, wheels)
    spin, speed, tau = rng.normal(size=3), rng.uniform(-100.0, 100.0, 4), rng.normal(size=4)
    v, force = np.concatenate([np.zeros(3), spin, speed]), np.concatenate([np.zeros(6), tau])
    q = pin.neutral(whole)
    q[7:] = rng.uniform(-1e4, 1e4, 4)  # where the wheels stand matters to nobody
    found = pin.aba(whole, whole.createData(), q, v, force)
    J = tensor - wheels.spin_inertia
    h = wheels.inertia * (speed + wheels.axes @ spin)
    turn = np.linalg.solve(J, -wheels.total(tau) - np.cross(spin, J @ spin + wheels.total(h)))
    np.testing.assert_allclose(found[3:6], turn, rtol=1e-12)
    np.testing.assert_allclose(wheels.inertia * (found[6:] + wheels.axes @ turn), tau, rtol=1e-10)
