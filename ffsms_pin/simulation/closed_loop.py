"""The simulation of a closed loop of reference, controller and plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import Parameter, signature
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.client import Client
from ffsms_pin.control.base_command import BaseLaw, BaseView
from ffsms_pin.control.stopping import StoppingLaw
from ffsms_pin.errors import InvalidValue, SimulationDiverged, UnknownOption, numerical_errors
from ffsms_pin.references import Reference, Resettable, observers
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.estimator import place_deviation
from ffsms_pin.simulation.events import End, Event, Freeze, JointFault, Latch
from ffsms_pin.simulation.guards import Saturation, Watch
from ffsms_pin.simulation.interfaces import (
    CompensatesFriction,
    Controller,
    EstimatesRobot,
    Instant,
    Supervisor,
)
from ffsms_pin.simulation.loads import Load
from ffsms_pin.simulation.setup import (
    ConditionFields,
    Conditions,
    HasBaseMode,
    check_kinds,
    check_law,
    estimator_of,
    first_sample,
    set_up,
    warn_of_base,
    warn_of_friction,
    with_fields,
    wrench_listener,
)
from ffsms_pin.simulation.tracking import Record, Tracking, judged
from ffsms_pin.threads import one_blas_thread


def check_options(function: str, options: Mapping[str, Any]) -> None:
    """Raise `UnknownOption` if a name is no argument of `simulate`."""
    own = [p.name for p in signature(simulate).parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
    known = [*own, *ConditionFields.__annotations__]
    for name, value in options.items():
        if name not in known:
            raise UnknownOption(function, name, value, known)


@numerical_errors("the simulation")
@one_blas_thread()
def simulate(
    sms: SpaceManipulator,
    reference: Reference,
    controller: Controller,
    dt: float = 1e-3,
    q0: ArrayLike | None = None,
    plant: SpaceManipulator | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    conditions: Conditions | None = None,
    base_controller: BaseLaw | None = None,
    client: Client | None = None,
    loads: Load | Sequence[Load] = (),
    supervisor: Supervisor | None = None,
    **fields: Unpack[ConditionFields],
) -> Tracking:
    """Simulate the plant, from the start of the reference to its end, under the controller's torques.

    In each control step the controller receives the measured state and the reference's joint motion at the
    step's start, and the controller's torque is held over the step. The generalised force [0 (6); tau] acts
    on the plant, so no external force acts on the base. By default, one Runge-Kutta step of order 4
    (`rk4_step`) integrates the articulated-body dynamics. With a `base_controller` the plant's wheels and
    thrusters act on the base as well, and the wheels' speeds are part of the state. The `conditions` add
    imperfections. The recording has the plant's true motion and the torques after the actuators' limits and
    delays.

    Parameters
    ----------
    sms : SpaceManipulator
        The model from which the reference and the controller were made.
    reference : Reference
        A `Trajectory`, or an object with `duration`, `target` and `sample`. If it is an `Observer` as well,
        such as `opt.Replanning`, it observes the run.
    controller : Controller
        A joint torque law, such as a `SlidingModeController`.
    dt : float
        Control step [s], by default also the integration step. It is changed so that a whole number of steps
        makes up the duration.
    q0 : array_like, shape (nq,), optional
        Initial configuration of the plant. Default: the first configuration of the reference.
    plant : SpaceManipulator, optional
        The simulated robot, with the same joints as `sms` but, for example, other masses. Default: `sms`.
    progress : callable, optional
        A function called with the completed share of the run, 0 to 1.
    conditions : Conditions, optional
        Friction, actuators, sensors, disturbances, events, guards, initial motion and integrator. Default:
        `Conditions()`. Fields may also be passed by name, such as ``friction=JointFriction(...)``.
    base_controller : BaseLaw, optional
        The law of the plant's wheels and thrusters, such as `ffsms_pin.control.QuaternionFeedback`. Default:
        none; the wheels stand still relative to the base, and the base floats.
    client : Client, optional
        A second free body, which starts with the client's pose and twist at time zero.
    loads : Load or sequence of Load
        The forces and torques between end effector and client, see `ffsms_pin.simulation.Load`.
    supervisor : Supervisor, optional
        An object that chooses events in each control step.

    Returns
    -------
    Tracking
        The recording. Its `note` lists events, joints at their torque limits, and a change of the total
        momentum without an external force. Such a change is caused by too large a step or too steep friction.
        If a guard or a `Freeze` stopped the flight, `stopped` has the reason. A run with a supervisor is not
        judged, so its `arrived` is False.

    Raises
    ------
    InvalidValue
        A type or shape is wrong, a number is out of range, or the plant has other joints.
    SimulationDiverged
        The state, a torque or a command to the base's actuators is not finite; the error has the recording
        until then.
    ResultError
        The file of the guards cannot be written; raised before the run.
    """
    check_kinds(reference, controller, progress, supervisor, base_controller)
    check_options("simulate", fields)
    conditions = Conditions() if conditions is None else conditions
    instance("conditions", conditions, Conditions)
    conditions = with_fields(conditions, fields)
    observing = observers(reference=reference, controller=controller)
    if conditions.estimator is None:
        conditions = replace(conditions, estimator=any(observer.replans for observer in observing))
    sensors, actuator, guards = conditions.sensors, conditions.actuator, conditions.guards
    setup = set_up(
        sms,
        reference,
        dt,
        q0,
        plant,
        conditions=conditions,
        base_controller=base_controller,
        client=client,
        loads=loads,
    )
    dt, t, q, v, world = setup.dt, setup.t, setup.q, setup.v, setup.world
    steps, plant, base, body = len(t) - 1, world.plant, world.base, world.client
    check_law(sms, controller)
    if conditions.friction is None:
        warn_of_friction(plant, controller)
    if isinstance(reference, HasBaseMode):
        warn_of_base(reference.base_mode, base_controller, sms, stacklevel=5)
    upcoming, estimating = setup.events, setup.estimator
    if sensors is not None and not sensors.perfect:
        for observer in observing:
            observer.expect_noise(place_deviation(sms, q, sensors, estimating))
    pass_wrench = wrench_listener(setup.measure_wrench, observing)
    if isinstance(controller, Resettable):
        controller.reset(dt)
    compensates = controller if isinstance(controller, CompensatesFriction) else None
    estimates, robot = controller if isinstance(controller, EstimatesRobot) else None, None
    work, last, tau, stopped, stopping = 0.0, steps, None, "", None
    saturation = Saturation(plant, controller, actuator, dt)
    watch = None if guards is None else Watch(guards, plant, conditions.wrist, dt)

    def happen(event: Event, now: float, k: int, q: FloatArray, v: FloatArray) -> FloatArray:
        """Apply an event at row k and return the post-event velocity."""
        nonlocal work, last, estimating, stopped, stopping
        record.check_momentum(k)
        before = world.totals(q, v)[1]
        v = world.apply(event, q, v)
        if not isinstance(event, Freeze):  # `stopped` has the reason of a `Freeze`
            record.happened(now, event)
        work += world.totals(q, v)[1] - before
        last = k if isinstance(event, End) else last
        if isinstance(event, Freeze) and stopping is None:
            stopped = f"stopped at {now:.4g} s: {event.reason}"
            model = sms if supervisor is None else supervisor.model
            stopping = StoppingLaw(model if robot is None else robot, dt, saturation.limit)
        if isinstance(event, Latch) and supervisor is not None:
            estimating = estimator_of(conditions.estimator, supervisor.model, sensors, dt)
        if isinstance(event, JointFault) and event.reported:
            for observer in observing:
                observer.joint_failed(event.index(plant), event.kind == "locked")
        return v

    def ended(rows: int) -> Tracking:
        """Return the first rows as a recording, judged if there is no supervisor."""
        recorded = replace(record.tracking(rows, saturation.notes()), stopped=stopped)
        return recorded if supervisor is not None else judged(recorded, reference, plant)

    def diverged(t: float, rows: int, what: str = "") -> SimulationDiverged:
        """Return the error for a state or command that is not finite; save the recording if a path is set."""
        recorded = ended(rows)
        saved = "" if guards is None else guards.saved(recorded)
        return SimulationDiverged(t, recorded, saved, *filter(None, [what]))

    stride = max(1, steps // 200)  # [steps] between two calls of `progress`

    # A diverging state may overflow; `record` checks that each row is finite.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            record = Record(world, t, setup.target)
        except MemoryError:
            message = f"makes {steps} steps, too many for the memory; use a longer dt or a shorter motion"
            raise InvalidValue("dt", dt, message) from None
        for k in range(steps + 1):
            now = float(t[k])
            while upcoming and upcoming[0].time <= now + 1e-9:
                v = happen(upcoming.pop(0), now, k, q, v)
            measured = seen_q, seen_v = (q, v) if setup.measure is None else setup.measure(q, v)
            if estimating is not None:
                seen_q, seen_v = estimating.update(seen_q, seen_v, tau, base.spinning)
            contact_wrench = world.wrench(now, q, v)
            if k < steps:
                if base.law is not None:
                    for observer in observing:
                        observer.observe_wheels(base.wheel_momentum)
                if pass_wrench is not None:
                    pass_wrench(now, world.wrist(now, q, contact_wrench))
                if stopping is None or supervisor is not None:
                    for observer in observing:
                        observer.observe_sensors(now, *measured)
                        observer.observe(now, seen_q, seen_v)
            if supervisor is not None and k < steps:
                pose, twist = (None, np.zeros(6)) if body is None else (body.pose, body.twist)
                joined, spinning = None if body is None else body.joined, base.wheel_momentum.copy()
                instant = Instant(
                    now, q.copy(), v.copy(), pose, twist, contact_wrench.copy(), spinning, joined
                )
                for event in supervisor.decide(instant):
                    v = happen(event, now, k, q, v)
                    contact_wrench = world.wrench(now, q, v)
            desired = reference.sample(now) if k else first_sample(reference, plant.n)
            if not record.add(k, q, v, desired, work, contact_wrench):
                raise diverged(float(t[max(k - 1, 0)]), k)
            if watch is not None and stopping is None and k < last:
                latched = body is not None and body.joined is not None
                state = world.plant, q, v, record.arrays["joint_error"][k], desired[1]
                if trip := watch.trip(k, *state, contact_wrench, latched, saturation, observing, world.limp):
                    freeze = [Freeze(now, trip.reason)]
                    for event in freeze if supervisor is None else supervisor.guard_tripped(instant, trip):
                        v = happen(event, now, k, q, v)
                    if trip.guard.startswith("contact"):
                        watch.handled(k)
            if k == last:
                break
            if stopping is not None:
                tau = stopping.torque(seen_q, seen_v, world.limp)
                desired = plant.layout.positions(seen_q), np.zeros(plant.n), np.zeros(plant.n)
            else:
                tau = np.asarray(controller.torque(seen_q, seen_v, *desired))
                if tau.shape != (plant.n,) or tau.dtype.kind not in "fiu":
                    raise InvalidValue("controller.torque", tau, f"must return numbers of shape ({plant.n},)")
                saturation.commanded(tau)
                if estimates is not None and estimates.robot not in (robot, estimates.sms):
                    robot = estimates.robot
                    for observer in observing:
                        observer.observe_robot(robot)
            if setup.limit_torque is not None:
                tau = setup.limit_torque(tau)
            what = "" if all(map(math.isfinite, tau.tolist())) else "the controller's torque is not finite at"
            if base.law is not None and not what:
                acting_tau = tau
                if stopping is None and compensates is not None:
                    acting_tau = tau - compensates.friction_torque
                view = BaseView(now, seen_q, seen_v, base.wheel_momentum, desired, acting_tau)
                what = "" if base.command(view) else "the base controller's command is not finite at"
            if what:
                raise diverged(now, k + 1, what)
            record.acted(k, tau)
            q, v, done = world.step(now, q, v, tau, dt)
            work += done
            if progress is not None and ((k + 1) % stride == 0 or k + 1 == steps):
                progress((k + 1) / steps)
        record.check_momentum(last + 1)
        recorded = ended(last + 1)
        remark = guards.saved(recorded) if guards is not None and stopped else ""
        return replace(recorded, note=f"{recorded.note}; {remark}") if remark else recorded
