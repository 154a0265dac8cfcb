"""Wheels and thrusters, and the model in which wheels are joints."""

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


def test_axes_become_unit_vectors_and_numbers_apply_to_each_wheel() -> None:
    wheels = ffsms.ReactionWheels(PYRAMID, 1e-3, 0.1, [1.0, 2.0, 3.0, np.inf])
    np.testing.assert_allclose(np.linalg.norm(wheels.axes, axis=1), 1.0)
    np.testing.assert_array_equal(wheels.inertia, np.full(4, 1e-3))
    assert wheels.names[3] == "wheel 4"
    for array in (wheels.axes, wheels.momentum):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    single = ffsms.ReactionWheels([0, 0, 2], 1e-3)
    np.testing.assert_array_equal(single.axes, [[0.0, 0.0, 1.0]])
    assert len(single) == 1


@pytest.mark.parametrize(
    ("keywords", "fragments"),
    [
        ({"axes": [[0, 0, 0]], "inertia": 1.0}, ["wheels.axes", "length zero"]),
        ({"axes": PYRAMID, "inertia": 0.0}, ["wheels.inertia", "above zero [kg m^2]"]),
        ({"axes": PYRAMID, "inertia": [1.0, 2.0]}, ["wheels.inertia", "(4,)"]),
        ({"axes": PYRAMID, "inertia": 1.0, "torque": -1.0}, ["wheels.torque", "N m"]),
        ({"axes": PYRAMID, "inertia": 1.0, "names": ["a"]}, ["wheels.names", "4 names"]),
    ],
)
def test_invalid_wheels_are_refused(
    refused: Refused, keywords: dict[str, object], fragments: list[str]
) -> None:
    refused(lambda: ffsms.ReactionWheels(**keywords), InvalidValue, *fragments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("keywords", "fragments"),
    [
        ({"directions": [[1, 0, 0]]}, ["thrusters.directions", "2 rows"]),
        ({"least_on_time": 0.0}, ["thrusters.period"]),
        ({"period": 0.01}, ["thrusters.period", "least_on_time"]),
        ({"specific_impulse": 0.0}, ["thrusters.specific_impulse", "[s]"]),
    ],
)
def test_invalid_thrusters_are_refused(
    refused: Refused, keywords: dict[str, object], fragments: list[str]
) -> None:
    good: dict[str, object] = {
        "places": [[0, 1, 0], [0, -1, 0]],
        "directions": [[1, 0, 0], [1, 0, 0]],
        "force": 1.0,
        "least_on_time": 0.02,
    }
    ffsms.Thrusters(**good)  # type: ignore[arg-type]
    refused(lambda: ffsms.Thrusters(**{**good, **keywords}), InvalidValue, *fragments)  # type: ignore[arg-type]


def test_thrusters_give_a_force_and_a_moment_about_the_root(rng: np.random.Generator) -> None:
    places, directions = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    thrusters = ffsms.Thrusters(places, directions, 2.0, proportional=True, specific_impulse=200.0)
    force = rng.uniform(0.0, 2.0, 5)
    vectors = [
        f * direction / np.linalg.norm(direction) for f, direction in zip(force, directions, strict=True)
    ]
    moments = [np.cross(place, vector) for place, vector in zip(places, vectors, strict=True)]
    expected = np.concatenate([np.sum(vectors, axis=0), np.sum(moments, axis=0)])
    np.testing.assert_allclose(thrusters.wrenches @ force, expected, rtol=1e-13)
    assert thrusters.flow(force) == pytest.approx(force.sum() / (200.0 * 9.80665))


def test_actuators_stay_with_a_robot_and_do_not_change_its_dynamics(planar: ffsms.SpaceManipulator) -> None:
    wheels, thrusters = (
        ffsms.ReactionWheels(np.eye(3), 1e-3),
        ffsms.Thrusters([1, 0, 0], [0, 1, 0], 1.0, proportional=True),
    )
    robot = planar.with_actuators(wheels=wheels, thrusters=thrusters)
    assert planar.wheels is None
    for derived in (robot, robot.with_limits(robot.limits), robot.with_inertias(robot.model)):
        assert derived.wheels is wheels
        assert derived.thrusters is thrusters
    copied = pickle.loads(pickle.dumps(robot))
    np.testing.assert_array_equal(copied.wheels.axes, wheels.axes)
    assert robot.with_actuators(thrusters=thrusters).wheels is None
    assert (robot.n, robot.joint_names) == (planar.n, planar.joint_names)
    q, v = planar.configuration([0.1, 0.2, 0.3]), np.arange(9.0) / 10.0
    with_actuators, plain = robot.at(q, v), planar.at(q, v)
    for name in ("C_bm", "H", "J_star", "momentum"):
        np.testing.assert_array_equal(getattr(with_actuators, name), getattr(plain, name))
    assert with_actuators.coupling.entropy == plain.coupling.entropy
    with pytest.raises(AttributeError, match="with_actuators"):
        robot.wheels = None


def test_wheels_heavier_than_their_satellite_are_refused(
    planar: ffsms.SpaceManipulator, refused: Refused
) -> None:
    refused(
        lambda: planar.with_actuators(wheels=ffsms.ReactionWheels(np.eye(3), 1.12)),
        InvalidValue,
        "wheels.inertia",
        "includes the wheels",
    )
    refused(lambda: planar.with_actuators(wheels=3), InvalidValue, "wheels", "ReactionWheels")  # type: ignore[arg-type]


def test_the_model_with_wheels_satisfies_the_gyrostat_equations(rng: np.random.Generator) -> None:
    """Euler's equations of a base with wheels: J w' + w x (J w + a h) = -a tau, h' = tau."""
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
    q[7:] = rng.uniform(-1e4, 1e4, 4)  # the angles of the wheels have no effect
    acceleration = pin.aba(whole, whole.createData(), q, v, force)
    J = tensor - wheels.spin_inertia
    h = wheels.inertia * (speed + wheels.axes @ spin)
    turn = np.linalg.solve(J, -wheels.total(tau) - np.cross(spin, J @ spin + wheels.total(h)))
    np.testing.assert_allclose(acceleration[3:6], turn, rtol=1e-12)
    np.testing.assert_allclose(wheels.inertia * (acceleration[6:] + wheels.axes @ turn), tau, rtol=1e-10)
