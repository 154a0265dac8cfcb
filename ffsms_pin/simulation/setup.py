"""The arguments of `simulate`, checked and made ready for a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance, positive, step_count
from ffsms_pin.client import Client
from ffsms_pin.control.base_command import BaseLaw
from ffsms_pin.errors import InvalidValue
from ffsms_pin.files import check_writable
from ffsms_pin.references import Reference
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.bodies import BaseActuators, client_body
from ffsms_pin.simulation.conditions import Conditions
from ffsms_pin.simulation.devices import JointFriction, Measure
from ffsms_pin.simulation.estimator import RunningEstimator
from ffsms_pin.simulation.events import Event, checked_events
from ffsms_pin.simulation.integrators import INTEGRATORS
from ffsms_pin.simulation.interfaces import check_robots, estimator_of, start, target_function
from ffsms_pin.simulation.loads import Load
from ffsms_pin.simulation.world import World


@dataclass(eq=False)
class Setup:
    """A run before its first control step; one run uses it up.

    Attributes
    ----------
    dt : float
        Control step [s].
    t : ndarray, shape (N + 1,)
        The instants of the control steps [s], from 0 to the duration.
    q, v : ndarray, shape (nq,), (6 + n,)
        The plant's start.
    world : World
    target : callable
        The target's position (3,) as a function of time [s].
    events : list of Event
        In order of time.
    limit_torque : callable, optional
        The torques (n,) that act in place of commanded ones, if there is an actuator.
    measure : callable, optional
        The measured state in place of the true one, if there are sensors.
    estimator : RunningEstimator, optional
    measure_wrench : callable, optional
        The measured wrench (6,) in place of the true one, if there is a wrist sensor.
    """

    dt: float
    t: FloatArray
    q: FloatArray
    v: FloatArray
    world: World
    target: Callable[[float], FloatArray]
    events: list[Event]
    limit_torque: Callable[[FloatArray], FloatArray] | None
    measure: Measure | None
    estimator: RunningEstimator | None
    measure_wrench: Callable[[FloatArray], FloatArray] | None


def set_up(
    sms: SpaceManipulator,
    reference: Reference,
    dt: float = 1e-3,
    q0: ArrayLike | None = None,
    plant: SpaceManipulator | None = None,
    *,
    conditions: Conditions | None = None,
    base_controller: BaseLaw | None = None,
    client: Client | None = None,
    loads: Load | Sequence[Load] = (),
) -> Setup:
    """Check the arguments of `simulate` that describe the conditions of a run, and make the run ready.

    Raises
    ------
    InvalidValue
        An argument has a value, shape or type that cannot be used, or does not fit the plant or the duration.
    ResultError
        The file of the guards cannot be written.
    """
    plant = sms if plant is None else plant
    check_robots(sms, plant)
    conditions = Conditions() if conditions is None else conditions
    instance("conditions", conditions, Conditions)
    duration, dt = positive("reference.duration", reference.duration, "s"), positive("dt", dt, "s")
    if dt > duration * (1.0 + 1e-9):
        raise InvalidValue("dt", dt, f"must not exceed the reference's duration of {duration:g} s")
    steps = step_count("dt", duration, dt)
    dt = duration / steps
    q, v = start(plant, reference, q0, conditions.v0, conditions.momentum)
    base = BaseActuators(sms, plant, base_controller, dt, conditions.wheel_momentum)
    body = client_body(client, loads)
    integrate = INTEGRATORS[conditions.integrator]
    friction = conditions.friction
    if friction is None and (plant.joint_damping.any() or plant.joint_friction.any()):
        friction = JointFriction(plant.joint_damping, plant.joint_friction)
    actuator, sensors, wrist, guards = (
        conditions.actuator,
        conditions.sensors,
        conditions.wrist,
        conditions.guards,
    )
    setup = Setup(
        dt,
        np.linspace(0.0, duration, steps + 1),
        q,
        v,
        World(
            plant,
            integrate,
            friction,
            conditions.wrenches,
            base,
            body,
            1 if conditions.substeps is None else conditions.substeps,
        ),
        target_function(reference.target),
        checked_events(conditions.events, plant, duration),
        None if actuator is None else actuator.start(plant.n, dt, duration),
        None if sensors is None else sensors.start(plant, dt, duration),
        estimator_of(conditions.estimator, sms, sensors, dt),
        None if wrist is None else wrist.start(dt, duration),
    )
    if guards is not None and guards.path is not None:
        check_writable(guards.path)
    return setup
