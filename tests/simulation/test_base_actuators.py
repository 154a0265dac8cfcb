"""The closed loop with wheels and thrusters: conservation, limits, recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import Array, Constant, Swing, arrays_of, note_without_goal

import ffsms_pin as ffsms
from ffsms_pin.control import BaseCommand, BaseView, ComputedTorque
from ffsms_pin.errors import FfsmsError, InvalidValue, SimulationDiverged
from ffsms_pin.simulation import Capture, JointFault, JointFriction, Tracking, Wrench

Refused = Callable[..., FfsmsError]
PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
START = [0.4, -0.3, 0.2, 0.5]  # [N m s]


class FunctionLaw:
    """A base law given by a function."""

    def __init__(self, function: Callable[[BaseView], Any]) -> None:
        self.function = function

    def command(self, view: BaseView) -> Any:
        """Return the command of the function."""
        return self.function(view)


def wheeled(sms: ffsms.SpaceManipulator, **keywords: Any) -> ffsms.SpaceManipulator:
    return sms.with_actuators(wheels=ffsms.ReactionWheels(PYRAMID, 1.364e-3, **keywords))


def wave(view: BaseView) -> BaseCommand:
    return BaseCommand(0.05 * np.sin(3.0 * view.t + np.arange(4.0)))


def test_wheels_without_a_law_do_not_change_the_motion(
    planar: ffsms.SpaceManipulator, swing: Swing, swung: Tracking
) -> None:
    from ffsms_pin.control import SlidingModeController

    robot = wheeled(planar)
    same = ffsms.simulate(robot, swing, SlidingModeController(robot))
    for name in arrays_of(swung):
        np.testing.assert_array_equal(getattr(same, name), getattr(swung, name))
    assert same.wheel_momentum.shape == (2001, 0)


@pytest.mark.parametrize("integrator", ["rk4", "variational"])
def test_momentum_and_energy_are_kept(planar: ffsms.SpaceManipulator, swing: Swing, integrator: str) -> None:
    robot = wheeled(planar)
    run = ffsms.simulate(
        robot,
        swing,
        ComputedTorque(robot),
        dt=1e-3 if integrator == "rk4" else 4e-3,
        base_controller=FunctionLaw(wave),
        conditions=ffsms.Conditions(wheel_momentum=START, integrator=integrator),
    )
    size = np.linalg.norm(run.momentum[0])
    assert size > 0.1
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12 * size
    assert np.ptp(run.wheel_momentum, axis=0).min() > 1e-2
    assert (
        np.abs(run.energy_error).max() < (1e-10 if integrator == "rk4" else 2e-8) * run.kinetic_energy.max()
    )
    assert note_without_goal(run) == ""
    # The base turned with the wheel axes, so a gyroscopic torque acted.
    assert np.linalg.norm(run.v[-1, 3:6]) > 1e-3


def test_momentum_is_kept_for_forty_seconds(planar: ffsms.SpaceManipulator) -> None:
    """Use the step of benchmarks/wheels.py, which simulates an hour."""
    robot = wheeled(planar)
    swing = Swing(robot, duration=40.0)
    run = ffsms.simulate(
        robot,
        swing,
        ComputedTorque(robot),
        dt=0.01,
        base_controller=FunctionLaw(wave),
        conditions=ffsms.Conditions(wheel_momentum=START),
    )
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12 * np.linalg.norm(run.momentum[0])


def test_friction_slows_wheels_and_keeps_the_total_momentum(
    planar: ffsms.SpaceManipulator, swing: Swing
) -> None:
    robot = wheeled(planar, friction=1e-5, coulomb=1e-3)
    still = FunctionLaw(lambda view: BaseCommand())
    run = ffsms.simulate(
        robot,
        swing,
        ComputedTorque(robot),
        base_controller=still,
        conditions=ffsms.Conditions(wheel_momentum=START),
    )
    size = np.linalg.norm(run.momentum[0])
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12 * size
    lost = np.abs(run.wheel_momentum[0]) - np.abs(run.wheel_momentum[-1])
    # The integral of the friction torque of fast wheels: h' = -c h / I - d.
    rate, time = 1e-5 / 1.364e-3, 2.0
    remaining = (np.abs(START) + 1e-3 / rate) * np.exp(-rate * time) - 1e-3 / rate
    np.testing.assert_allclose(np.abs(START) - remaining, lost, rtol=5e-2)
    assert run.work[-1] < -0.1
    assert np.abs(run.energy_error).max() < 1e-9 * run.kinetic_energy.max()


def test_limits_of_wheels_are_kept_and_reported(planar: ffsms.SpaceManipulator, swing: Swing) -> None:
    robot = wheeled(planar, torque=0.1, momentum=0.6)
    law = FunctionLaw(lambda view: BaseCommand(np.array([0.3, -0.05, 0.0, 0.1])))
    run = ffsms.simulate(
        robot,
        swing,
        ComputedTorque(robot),
        base_controller=law,
        conditions=ffsms.Conditions(wheel_momentum=START),
    )
    assert np.abs(run.wheel_torque).max() <= 0.1
    assert np.abs(run.wheel_momentum).max() < 0.6 + 1e-6
    assert "t = 0 s: wheel 1 at its largest torque of 0.1 N m (for 2 s in all)" in run.note
    assert "wheel 1 at its largest momentum of 0.6 N m s" in run.note
    assert "wheel 4 at its largest momentum" in run.note
    assert "wheel 2" not in run.note
    # Wheel 4 reaches its limit after a second, because 0.1 N m s are left at 0.1 N m.
    assert run.wheel_torque[1100:, 3] == pytest.approx(0.0, abs=1e-3)
    size = np.linalg.norm(run.momentum[0])
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-12 * size


def test_thrusters_give_their_impulse(planar: ffsms.SpaceManipulator) -> None:
    """The linear momentum is the impulse, the angular one its moment; propellant follows the mass flow."""
    thrusters = ffsms.Thrusters(
        [[0, 0.2, 0], [0, -0.2, 0]], [[1, 0, 0], [1, 0, 0]], 0.5, proportional=True, specific_impulse=200.0
    )
    robot = planar.with_actuators(thrusters=thrusters)
    swing = Swing(robot, displacement=(0.0, 0.0, 0.0))
    both = FunctionLaw(
        lambda view: BaseCommand(thruster_force=np.array([0.4, 9.0 if view.t < 1.0 else -1.0]))
    )
    run = ffsms.simulate(robot, swing, ComputedTorque(robot), base_controller=both)
    np.testing.assert_allclose(run.thruster_force[[0, -1]], [[0.4, 0.5], [0.4, 0.0]])
    impulse = run.thruster_force.sum(axis=0) * 1e-3
    np.testing.assert_allclose(impulse, [0.8, 0.5])
    assert run.propellant[-1] == pytest.approx(1.3 / (200.0 * 9.80665))
    # The wrench in inertial axes about the moving centre of mass, by the trapezoidal rule.
    changes = np.zeros((2001, 6))
    for k in range(2000):
        for row in (k, k + 1):
            state = robot.at(run.q[row], run.v[row])
            turn = state.base_pose.rotation
            force = turn @ (thrusters.wrenches[:3] @ run.thruster_force[k])
            root = run.q[row, :3] - state.com
            moment = turn @ (thrusters.wrenches[3:] @ run.thruster_force[k]) + np.cross(root, force)
            changes[k + 1] += 0.5e-3 * np.concatenate([force, moment])
    np.testing.assert_allclose(run.momentum, np.cumsum(changes, axis=0), atol=1e-8)
    assert "momentum" not in run.note
    assert "t = 0 s: thrusters at their largest force (for 1 s in all)" in run.note


def test_saved_recordings_load_unchanged(
    planar: ffsms.SpaceManipulator, swing: Swing, tmp_path: Path
) -> None:
    thrusters = ffsms.Thrusters([0, 0, 0.2], [1, 0, 0], 0.1, proportional=True)
    robot = wheeled(planar).with_actuators(wheels=wheeled(planar).wheels, thrusters=thrusters)
    law = FunctionLaw(lambda view: BaseCommand(wave(view).wheel_torque, np.array([0.05])))
    run = ffsms.simulate(robot, swing, ComputedTorque(robot), dt=0.01, base_controller=law)
    run.save(tmp_path / "saved.npz")
    loaded = Tracking.load(tmp_path / "saved.npz")
    for name in arrays_of(run):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(run, name))
    assert run.thruster_force.shape == (200, 1)
    assert run.propellant[-1] > 0.0


def test_locked_joints_captures_and_wrenches_with_wheels(
    planar: ffsms.SpaceManipulator, swing: Swing
) -> None:
    robot = wheeled(planar)
    run = ffsms.simulate(
        robot,
        swing,
        ComputedTorque(robot),
        base_controller=FunctionLaw(wave),
        dt=2e-3,
        conditions=ffsms.Conditions(
            wheel_momentum=START,
            friction=JointFriction(0.01),
            events=[JointFault(0.5, 1, reported=False), Capture(1.0, 2.0, (0.1, 0.1, 0.1))],
        ),
    )
    size = np.linalg.norm(run.momentum[0])
    for rows in (run.momentum[:500], run.momentum[500:]):  # the client adds its momentum
        assert np.abs(rows - rows[0]).max() < 1e-12 * size
    assert np.ptp(run.q[251:, 8]) == 0.0
    assert np.abs(run.energy_error).max() < 1e-9 * run.kinetic_energy.max()
    pushed = ffsms.simulate(
        robot,
        swing,
        ComputedTorque(robot),
        base_controller=FunctionLaw(wave),
        dt=2e-3,
        conditions=ffsms.Conditions(
            wheel_momentum=START, disturbances=Wrench([0.1, 0.0, 0.0, 0.0, 0.02, 0.0])
        ),
    )
    np.testing.assert_allclose(pushed.momentum[-1, :3], [0.2, 0.0, 0.0], atol=1e-9)


def test_invalid_wheels_and_base_laws_are_refused(
    planar: ffsms.SpaceManipulator, swing: Swing, refused: Refused
) -> None:
    robot, law = wheeled(planar, momentum=1.0), Constant(np.zeros(3))

    def run(sms: ffsms.SpaceManipulator = robot, **keywords: Any) -> Tracking:
        return ffsms.simulate(sms, swing, law, **keywords)

    still = FunctionLaw(lambda view: BaseCommand(np.zeros(4)))
    refused(lambda: run(wheel_momentum=START), InvalidValue, "wheel_momentum", "base_controller")
    refused(lambda: run(base_controller=3), InvalidValue, "base_controller", "command(view)")
    refused(lambda: run(planar, base_controller=still), InvalidValue, "with_actuators(wheels=...)")
    refused(lambda: run(base_controller=still, wheel_momentum=[0.1]), InvalidValue, "(4,)")
    refused(lambda: run(base_controller=still, wheel_momentum=[2.0] * 4), InvalidValue, "largest momenta")
    refused(lambda: run(base_controller=still, plant=planar), InvalidValue, "base_controller", "plant")
    single_wheel = planar.with_actuators(wheels=ffsms.ReactionWheels([0, 0, 1], 1e-3))
    refused(lambda: run(base_controller=still, plant=single_wheel), InvalidValue, "plant", "as many wheels")
    refused(lambda: run(base_controller=FunctionLaw(lambda view: np.zeros(4))), InvalidValue, "BaseCommand")
    too_few = FunctionLaw(lambda view: BaseCommand(np.zeros(3)))
    refused(lambda: run(base_controller=too_few), InvalidValue, "wheel_torque", "(4,)")
    text = FunctionLaw(lambda view: BaseCommand(np.array(["a"] * 4)))
    refused(lambda: run(base_controller=text), InvalidValue, "wheel_torque")
    diverging = FunctionLaw(lambda view: BaseCommand(np.full(4, np.nan if view.t > 0.1 else 0.0)))
    with pytest.raises(SimulationDiverged, match="base controller") as caught:
        run(base_controller=diverging)
    assert len(caught.value.tracking.t) == 102


def test_the_law_receives_the_measured_state(planar: ffsms.SpaceManipulator, swing: Swing) -> None:
    views: list[BaseView] = []

    def record(view: BaseView) -> BaseCommand:
        views.append(view)
        return wave(view)

    robot = wheeled(planar)
    run = ffsms.simulate(robot, swing, ComputedTorque(robot), dt=0.01, base_controller=FunctionLaw(record))
    k = 57
    expected: list[tuple[Array, Array]] = [
        (views[k].q, run.q[k]),
        (views[k].v, run.v[k]),
        (views[k].tau, run.tau[k]),
        (views[k].wheel_momentum, run.wheel_momentum[k]),
        (views[k].desired[0], swing.sample(0.57)[0]),
    ]
    for received, recorded in expected:
        np.testing.assert_allclose(received, recorded, rtol=1e-13)
    assert views[k].t == pytest.approx(0.57)
