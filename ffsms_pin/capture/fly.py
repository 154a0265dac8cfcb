"""The function `fly`, which plans and simulates a capture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin import checks, opt
from ffsms_pin.capture.camera import Camera
from ffsms_pin.capture.flight import Flight
from ffsms_pin.capture.options import (
    Belief,
    Control,
    Grip,
    Nozzle,
    Planning,
    Replan,
    Ring,
)
from ffsms_pin.capture.prediction import Envelope
from ffsms_pin.capture.procedure import CaptureOptions, Procedure
from ffsms_pin.capture.recording import captured
from ffsms_pin.capture.rendezvous import Rendezvous
from ffsms_pin.capture.state_machine import TOUCH, StateMachine
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client
from ffsms_pin.errors import InvalidValue, numerical_errors
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.references import Rest
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Close, Conditions, End, Latch, Open
from ffsms_pin.simulation.setup import check_robots, checked_events, set_up, warn_of_base
from ffsms_pin.system.dynamics import MODES


@numerical_errors("the capture")
def fly(
    sms: SpaceManipulator,
    q0: ArrayLike,
    goal: opt.Meet,
    duration: float = 12.0,
    *,
    camera: Camera | None = None,
    belief: Belief | None = None,
    grip: Grip | None = None,
    guide: Nozzle | Ring | None = None,
    envelope: Envelope | None = None,
    control: Control | Callable[[SpaceManipulator], Any] | None = None,
    plant: SpaceManipulator | None = None,
    plant_q0: ArrayLike | None = None,
    conditions: Conditions | None = None,
    replan: Replan | opt.ReplanOptions | bool | None = None,
    planning: Planning | None = None,
    procedure: Procedure | None = None,
    plan: opt.Trajectory | None = None,
    progress: Callable[[float], None] | None = None,
) -> Flight:
    """Simulate a capture in closed loop: plan, approach the client, grasp it, and brake the joints.

    Parameters
    ----------
    sms : SpaceManipulator
        The model for plans and control laws.
    q0 : array_like, shape (nq,)
        Initial configuration, see `sms.configuration`.
    goal : opt.Meet
        The true client, with its time zero at the start, and the grasp on the client.
    duration : float
        Time to the contact [s], above zero.
    camera : Camera, optional
        The sensor that measures the client. Default: the client's motion, mass and inertia are known.
    belief : Belief, optional
        The assumed mass and inertia of the client; requires a camera. Default: the true ones.
    grip : Grip, optional
        A compliant grip. Default: the grip is rigid when the gripper closes.
    guide : Nozzle or Ring, optional
        The contact surfaces at the grasp. Default: none.
    envelope : Envelope, optional
        The errors within which the gripper can grasp the client. Default: `Envelope()`.
    control : Control or callable, optional
        The control laws of joints and base, or a function that takes a robot and returns the law of its
        joints. Default: `Control()`.
    plant : SpaceManipulator, optional
        The simulated robot, with the same joints as `sms`. Default: `sms`.
    plant_q0 : array_like, shape (nq,), optional
        Configuration of the plant at the start. Default: `q0`.
    conditions : Conditions, optional
        Conditions of the simulation: sensors, friction, disturbances, guards, initial motion. The events may
        be joint faults and captures of payloads. `momentum` is the servicer's initial momentum, by default
        that of the plan.
    replan : Replan, opt.ReplanOptions or bool, optional
        Options of re-planning from the measured state; True for the defaults. Default: True if there is a
        camera, else False. If `replan` is False and there is a camera, all plans use one measurement before
        the flight.
    planning : Planning, optional
        Options of the plan, such as the time step, limits and obstacles. Default: `Planning()`.
    procedure : Procedure, optional
        Options of the go decision, attempts, retreat and braking. Default: `Procedure()`.
    plan : Trajectory, optional
        An existing plan from `q0` to the client, of the same duration. Default: the motion is planned first.
    progress : callable, optional
        A function that is called with the completed share of the simulation, 0 to 1.

    Returns
    -------
    Flight
        The recorded flight. If the client was not latched, `latched` is False and `outcome` has the reason.

    Raises
    ------
    InvalidValue
        If the goal has no client, a shape is wrong, a number is out of range, or options are incompatible.
    SimulationDiverged
        If the state or a torque becomes infinite or NaN.

    Examples
    --------
    >>> flight = capture.fly(sms, q0, opt.Meet(client, grasp), duration=12.0, camera=capture.Camera())
    >>> flight.outcome, flight.states
    """
    meeting = Rendezvous(
        sms, q0, goal, duration, Planning() if planning is None else planning, camera, belief, grip, guide
    )
    laws = _control(control)
    checks.instance("envelope", envelope, Envelope, optional=True)
    checks.instance("conditions", conditions, Conditions, optional=True)
    checks.instance("procedure", procedure, Procedure, optional=True)
    checks.optional_callable("progress", progress)
    again = _replan(replan, camera is not None)
    plant = sms if plant is None else plant
    check_robots(sms, plant)
    start = meeting.q0 if plant_q0 is None else plant.checked_configuration("plant_q0", plant_q0)
    options: dict[str, Any] = {
        "dt": laws.dt,
        "q0": start,
        "plant": plant,
        "conditions": Conditions() if conditions is None else conditions,
    }
    _check_conditions(meeting, laws, options)
    handling = _handling(meeting, envelope or Envelope(), procedure or Procedure())
    _check_start(handling, plant, "q0" if plant_q0 is None else "plant_q0", start, meeting.client)
    if plan is None:
        plan = meeting.plan()
    else:
        _check_plan(meeting, plan)
    warn_of_base(plan.mode, laws.laws(sms)[1], sms, stacklevel=4)
    reference = meeting.reference(plan, again)
    meet = replace(meeting.goal, client=meeting.known(reference))
    mission = StateMachine(sms, plant, plan, reference, meet, laws.laws, handling, laws.dt, meeting.problem)
    recording = captured(mission, meeting.client, options, progress)
    if progress is not None:
        progress(1.0)
    note = reference.note if isinstance(reference, opt.Replanning) else ""
    return Flight(plan, recording, plant, note, meeting.given_obstacles, meeting.goal.grasp)


def _values(options: Any) -> dict[str, Any]:
    return {field.name: getattr(options, field.name) for field in fields(options) if field.init}


def _control(control: Any) -> Control:
    """Return `control` as a `Control`; None gives the default laws."""
    if control is None:
        return Control()
    if isinstance(control, Control):
        return control
    if not callable(control):
        message = "must be a capture.Control, or a function from a robot to the law of its joints, such as \
control=lambda robot: ComputedTorque(robot, K_p=100.0, adaptive=False)"
        raise InvalidValue("control", control, message)
    return Control(control)


def _replan(replan: Any, sees: bool) -> Replan | None:
    """Return the options of re-planning; None if the motion is planned once."""
    if replan is None:
        replan = sees
    checks.instance("replan", replan, (opt.ReplanOptions, bool))
    if isinstance(replan, bool):
        return Replan() if replan else None
    return replan if isinstance(replan, Replan) else Replan(**_values(replan))


def _check_conditions(meeting: Rendezvous, laws: Control, options: dict[str, Any]) -> None:
    """Raise `InvalidValue` for conditions, a plant or a base mode that the simulation does not support."""
    plant, conditions = options["plant"], options["conditions"]
    # The duration of a capture is not fixed, so an event may have any time.
    for event in checked_events(conditions.events, plant, np.inf):
        if isinstance(event, (Close, Open, Latch, End)):
            message = (
                "must be joint faults or payloads; the capture itself closes, opens and latches its gripper"
            )
            raise InvalidValue("conditions.events", event, message)
    options = {**options, "conditions": replace(conditions, events=())}
    _, options["base_controller"] = laws.laws(meeting.sms)
    mode = meeting.planning.mode
    if mode != "floating" and options["base_controller"] is None:
        checks.one_of("planning.mode", mode, MODES)
        law = {"flying": "control.StationKeeping"}.get(mode, "control.QuaternionFeedback")
        if mode == "translation-flying":
            law = "lambda robot: control.StationKeeping(robot, holds='place')"
        message = f"requires a base law, such as control=capture.Control(base={law})"
        raise InvalidValue("planning.mode", mode, message)
    rest = Rest(meeting.duration, np.zeros(3), meeting.sms.joint_positions(meeting.q0))
    set_up(meeting.sms, rest, **options)


def _check_plan(meeting: Rendezvous, plan: Any) -> None:
    """Raise `InvalidValue` unless a plan starts at q0 and has the duration of the flight."""
    checks.instance("plan", plan, opt.Trajectory)
    if plan.q.shape[1] != meeting.sms.nq or not np.allclose(plan.q[0], meeting.q0, atol=1e-6):
        raise InvalidValue("plan.q[0]", plan.q[0], "must equal q0: plan from the configuration at the start")
    if abs(plan.duration - meeting.duration) > 1e-6:
        message = f"must equal the argument duration, {meeting.duration:g} s"
        raise InvalidValue("plan.duration", plan.duration, message)


def _handling(meeting: Rendezvous, envelope: Envelope, procedure: Procedure) -> CaptureOptions:
    """Return the options of the capture."""
    limit, around, grip = meeting.clearance, meeting.obstacles(meeting.client), meeting.grip
    room = None
    if around:
        shapes = [obstacle for obstacle in around if obstacle.moves and obstacle.piece_of is None]
        others = [obstacle for obstacle in around if not obstacle.moves]
        room = partial(HeldClient, meeting.sms, shapes, limit.clearance, limit.collision, obstacles=others)
    return CaptureOptions(
        envelope=envelope,
        grip=None if grip is None else grip.load(meeting.goal.grasp),
        guide=None if meeting.scene is None else meeting.scene.load,
        time=CaptureOptions.time if grip is None else grip.time,
        room=room,
        obstacles=tuple(around),
        bodies=tuple(meeting.bodies()),
        clearance=limit.clearance,
        collision=limit.collision,
        **_values(procedure),
    )


def _check_start(
    handling: CaptureOptions, plant: SpaceManipulator, name: str, q0: FloatArray, client: Client
) -> None:
    """Raise `InvalidValue` if servicer and client overlap at the start, by more than a tolerance."""
    if (touching := handling.touching(plant)) is None:
        return
    distance, pair = touching.at(q0, client.pose(0.0))
    if distance < -TOUCH:
        overlap = f"{pair} overlap by {-1e3 * distance:.3g} mm at the start"
        message = f"must keep servicer and client apart: {overlap}; change {name} or the client's pose"
        raise InvalidValue(name, q0, message)
