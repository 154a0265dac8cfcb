"""The closed loop: reference, controller and plant under forward dynamics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client
from ffsms_pin.contact import Load
from ffsms_pin.control.base_command import BaseLaw, BaseView
from ffsms_pin.control.stopping import StoppingLaw
from ffsms_pin.errors import InvalidValue, SimulationDiverged, numerical_errors
from ffsms_pin.references import Reference, Resettable, observers
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.devices import Actuator, JointFriction, Sensors, WristSensor, wrist_told
from ffsms_pin.simulation.estimator import Estimator, place_deviation
from ffsms_pin.simulation.events import End, Event, Freeze, JointFault, Latch, Wrench
from ffsms_pin.simulation.guards import GUARDS, Guards, Saturation, Watch
from ffsms_pin.simulation.interfaces import (
    CompensatesFriction,
    Controller,
    Instant,
    Supervisor,
    check_kinds,
    estimator_of,
    first_sample,
)
from ffsms_pin.simulation.record import Record
from ffsms_pin.simulation.setup import set_up
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.simulation.verdict import judged
from ffsms_pin.threads import one_blas_thread


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
    v0: ArrayLike | None = None,
    momentum: ArrayLike | None = None,
    integrator: str = "rk4",
    friction: JointFriction | None = None,
    actuator: Actuator | None = None,
    sensors: Sensors | None = None,
    wrist: WristSensor | None = None,
    estimator: Estimator | bool | None = None,
    disturbances: Wrench | Sequence[Wrench] = (),
    events: Event | Sequence[Event] = (),
    guards: Guards | None = GUARDS,
    base_controller: BaseLaw | None = None,
    wheel_momentum: ArrayLike | None = None,
    client: Client | None = None,
    loads: Load | Sequence[Load] = (),
    substeps: int = 1,
    supervisor: Supervisor | None = None,
) -> Tracking:
    """Simulate the plant, from the start of the reference to its end, under the controller's torques.

    In each control step the controller is given the plant's state and the reference's joint motion at the
    step's start, and its torque is held over the step. The plant moves by its articulated-body dynamics with
    the generalised force [0 (6); tau], so nothing acts on the base, integrated by one Runge-Kutta step of
    order 4 (see `rk4_step`). With a `base_controller` the plant's wheels and thrusters act on the base as
    well, and the wheels' speeds are part of the state. The other keyword options below each add one
    imperfection; what is recorded is the plant's true motion and the torque that acts.

    Parameters
    ----------
    sms : SpaceManipulator
        The model that the reference and the controller were made with.
    reference : Reference
        A `Trajectory`, or an object with `duration`, `target` and `sample`. If it is an `Observer` as well,
        such as `opt.Replanning`, it observes the run.
    controller : Controller
        Such as a `SlidingModeController`.
    dt : float
        Control and integration step [s]. A whole number of steps makes up the duration, so the step used is
        the nearest that does.
    q0 : array_like, shape (nq,), optional
        Start of the plant; default: that of the reference.
    plant : SpaceManipulator, optional
        What is simulated, with the same joints as `sms`: another mass or inertia than the model's. Default:
        `sms`.
    progress : callable, optional
        Called with the share of the work done, 0 to 1.
    v0 : array_like, shape (6 + n,), optional
        Velocity of the plant at the start. Default: the reference's joint rates and momentum, and at rest
        what it holds of the base (`base_mode`, a plan's `mode`).
    momentum : array_like, shape (6,), optional
        Total momentum at the start [linear; angular], inertial axes, about the centre of mass, in place of
        `v0`; the base moves by it as a floating one, whatever the reference holds. Default: that of the
        reference, zero where it has none.
    integrator : str
        One of `INTEGRATORS`: "rk4", "variational", "adaptive", "stiff".
    friction : JointFriction, optional
    actuator : Actuator, optional
        Saturation, rate limit and delay of the torques.
    sensors : Sensors, optional
        What the controller and the reference see instead of the true state.
    wrist : WristSensor, optional
        A sensor that reference and controller observe (`Observer.observe_wrench`).
    estimator : Estimator or bool, optional
        What is made of the measurements before controller and reference see them: filtered, and carried over
        the sensors' latency with the model `sms`. True: `Estimator()`; False: they are shown as they are.
        Default: True for a reference that plans again in the loop (`Observer.replans`), False for any
        other. Perfect sensors need none, and get none.
    disturbances : Wrench or sequence of them
        External forces.
    events : Event or sequence of them
        Captures and joint faults; told in the result's `note`.
    guards : Guards, optional
        Limits of the flight; one that is exceeded stops it: the joints are braked, and the result's `stopped`
        says why. Default: `Guards()`; None for none.
    base_controller : BaseLaw, optional
        What the plant's wheels and thrusters do, such as `ffsms_pin.control.QuaternionFeedback`: anything
        with a method ``command(view)``. Default: nothing; the wheels stand still and the base floats.
    wheel_momentum : array_like, shape (w,), optional
        Spin momenta of the wheels at the start [N m s], against the base; `momentum` does not count them.
        Default: the wheels stand still.
    client : Client, optional
        A second free body, that moves as it does at its time zero when the run begins.
    loads : Load or sequence of them
        What acts between end effector and client, see `ffsms_pin.contact`.
    substeps : int
        Integration steps in a control step. In a run with a client they are made in the steps in which a
        contact acts, for a stiff contact moves faster than an arm.
    supervisor : Supervisor, optional
        Decides while the run goes on which events happen next.

    Returns
    -------
    Tracking
        Its `note` says what happened: also that joints were at their torque limits, or that the total
        momentum changed though nothing acts from outside, for which too large a step or too steep a friction
        is to blame. `stopped` holds what stopped the flight.

    Raises
    ------
    InvalidValue
        A wrong shape or a number out of range, or a plant with other joints.
    SimulationDiverged
        The state or a torque stopped being finite; the error carries what was recorded until then.
    ResultError
        The file of the guards cannot be written; raised before the run.
    """
    check_kinds(reference, controller, progress, supervisor, base_controller)
    observing = observers(reference=reference, controller=controller)
    if estimator is None:
        estimator = any(observer.replans for observer in observing)
    setup = set_up(
        sms,
        reference,
        dt,
        q0,
        plant,
        v0=v0,
        momentum=momentum,
        integrator=integrator,
        friction=friction,
        actuator=actuator,
        sensors=sensors,
        wrist=wrist,
        estimator=estimator,
        disturbances=disturbances,
        events=events,
        guards=guards,
        base_controller=base_controller,
        wheel_momentum=wheel_momentum,
        client=client,
        loads=loads,
        substeps=substeps,
    )
    dt, t, q, v, world = setup.dt, setup.t, setup.q, setup.v, setup.world
    steps, plant, base, body = len(t) - 1, world.plant, world.base, world.client
    coming, estimating = setup.events, setup.estimator
    if sensors is not None and not sensors.perfect:
        for observer in observing:
            observer.expect_noise(place_deviation(sms, q, sensors, estimating))
    feel = wrist_told(setup.measure_wrench, observing)
    if isinstance(controller, Resettable):
        controller.reset(dt)
    compensates = controller if isinstance(controller, CompensatesFriction) else None
    work, last, tau, stopped, stopping = 0.0, steps, None, "", None
    saturation = Saturation(plant, controller, actuator, dt)
    watch = None if guards is None else Watch(guards, plant, wrist, dt)

    def happen(event: Event, now: float, k: int, q: FloatArray, v: FloatArray) -> FloatArray:
        """Let it happen at row k; the velocity right after."""
        nonlocal work, last, estimating, stopped, stopping
        record.check_momentum(k)
        before = world.totals(q, v)[1]
        v = world.apply(event, q, v)
        if not isinstance(event, Freeze):  # that is in `stopped`
            record.happened(now, event)
        work += world.totals(q, v)[1] - before
        last = k if isinstance(event, End) else last
        if isinstance(event, Freeze) and stopping is None:
            stopped = f"stopped at {now:.4g} s: {event.reason}"
            model = sms if supervisor is None else supervisor.model
            stopping = StoppingLaw(model, dt, saturation.limit)
        if isinstance(event, Latch) and supervisor is not None:
            estimating = estimator_of(estimator, supervisor.model, sensors, dt)
        if isinstance(event, JointFault) and event.told:
            for observer in observing:
                observer.joint_failed(event.index(plant), event.kind == "locked")
        return v

    def ended(rows: int) -> Tracking:
        """Return the first rows as a recording, with its verdict unless a supervisor has one of its own."""
        recorded = replace(record.tracking(rows, saturation.notes()), stopped=stopped)
        return recorded if supervisor is not None else judged(recorded, reference, plant)

    def diverged(t: float, rows: int, what: str = "") -> SimulationDiverged:
        """Return the error of a state or torque that is not finite, after saving what was recorded."""
        recorded = ended(rows)
        told = "" if guards is None else guards.saved(recorded)
        return SimulationDiverged(t, recorded, told, *filter(None, [what]))

    stride = max(1, steps // 200)  # a progress bar needs no more

    # On its way to infinity a diverging state overflows here and there; the record finds out.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            record = Record(world, t, setup.target)
        except MemoryError:
            words = f"makes {steps} steps, too many for this memory; take a longer one, or a shorter motion"
            raise InvalidValue("dt", dt, words) from None
        for k in range(steps + 1):
            now = float(t[k])
            while coming and coming[0].time <= now + 1e-9:
                v = happen(coming.pop(0), now, k, q, v)
            seen_q, seen_v = (q, v) if setup.measure is None else setup.measure(q, v)
            if estimating is not None:
                seen_q, seen_v = estimating.update(seen_q, seen_v, tau, base.spinning)
            felt = world.wrench(now, q, v)
            if k < steps:
                if base.law is not None:
                    for observer in observing:
                        observer.observe_wheels(base.wheel_momentum)
                if feel is not None:
                    feel(now, world.wrist(now, q, felt))
                if stopping is None or supervisor is not None:
                    for observer in observing:
                        observer.observe(now, seen_q, seen_v)
            if supervisor is not None and k < steps:
                pose, twist = (None, np.zeros(6)) if body is None else (body.pose, body.twist)
                joined, spinning = None if body is None else body.joined, base.wheel_momentum.copy()
                instant = Instant(now, q.copy(), v.copy(), pose, twist, felt.copy(), spinning, joined)
                for event in supervisor.decide(instant):
                    v = happen(event, now, k, q, v)
                    felt = world.wrench(now, q, v)
            wanted = reference.sample(now) if k else first_sample(reference, plant.n)
            if not record.add(k, q, v, wanted, work, felt):
                raise diverged(float(t[max(k - 1, 0)]), k)
            if watch is not None and stopping is None and k < last:
                latched = body is not None and body.joined is not None
                state = world.plant, q, v, record.arrays["joint_error"][k], wanted[1]
                if trip := watch.trip(k, *state, felt, latched, saturation, observing, world.limp):
                    freeze = [Freeze(now, trip.reason)]
                    for event in freeze if supervisor is None else supervisor.guard_tripped(instant, trip):
                        v = happen(event, now, k, q, v)
                    if trip.guard.startswith("contact"):
                        watch.handled(k)
            if k == last:
                break
            if stopping is not None:
                tau = stopping.torque(seen_q, seen_v, world.limp)
                wanted = plant.layout.positions(seen_q), np.zeros(plant.n), np.zeros(plant.n)
            else:
                tau = np.asarray(controller.torque(seen_q, seen_v, *wanted))
                if tau.shape != (plant.n,) or tau.dtype.kind not in "fiu":
                    raise InvalidValue("controller.torque", tau, f"must return numbers of shape ({plant.n},)")
                saturation.commanded(tau)
            if setup.limit_torque is not None:
                tau = setup.limit_torque(tau)
            what = "" if all(map(math.isfinite, tau.tolist())) else "the controller's torque is not finite at"
            if base.law is not None and not what:
                felt_tau = tau
                if stopping is None and compensates is not None:
                    felt_tau = tau - compensates.friction_torque
                view = BaseView(now, seen_q, seen_v, base.wheel_momentum, wanted, felt_tau)
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
        told = guards.saved(recorded) if guards is not None and stopped else ""
        return replace(recorded, note=f"{recorded.note}; {told}") if told else recorded
