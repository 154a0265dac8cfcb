"""`capture.fly`: captures from Python equal those of scenario files, and invalid arguments are refused."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from own_parts import Below
from scenario_files import CAPTURE, write

import ffsms_pin as ffsms
from ffsms_pin import capture, opt, scenarios, simulation
from ffsms_pin.control import ComputedTorque, QuaternionFeedback
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue
from ffsms_pin.robot.base_motion import straight_end
from ffsms_pin.scenarios.definition import packaged_path

Refused = Callable[..., FfsmsError]
START = [0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8]
GRASP = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))
BOX = [0.5, 0.6, 0.7]
LAW = capture.Control(partial(ComputedTorque, K_p=100.0, K_d=20.0, adaptive=False), dt=0.004)


def _reached(
    sms: ffsms.SpaceManipulator,
    q0: Any,
    joints: list[float],
    duration: float,
    grasp: pin.SE3,
    body: tuple[float, list[float]],
    twist: list[float],
    shapes: list[Any],
) -> ffsms.Client:
    """Return a client whose grasp is where a straight joint-space move ends at the deadline."""
    end = sms.at(straight_end(sms, q0, np.array(joints), duration, None)).end_effector_pose
    at_deadline = ffsms.Client(*body, end * grasp.inverse(), twist)
    return ffsms.Client(*body, at_deadline.pose(-duration), at_deadline.twist(-duration), shapes)


def _servicer_and_client(duration: float = 6.0) -> tuple[ffsms.SpaceManipulator, Any, ffsms.Client]:
    """Return servicer, start and client of `CAPTURE`."""
    sms = ffsms.load("satellite_panda")
    q0, spin = sms.configuration(START), [math.radians(rate) for rate in (1.0, 2.0, -1.0)]
    joints, body = [0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9], (80.0, [6.0, 9.0, 11.0])
    shapes = [coal.Box(*BOX)]
    return sms, q0, _reached(sms, q0, joints, duration, GRASP, body, [0.0, 0.0, 0.0, *spin], shapes)


def _check_equal(flight: capture.Flight, outcome: scenarios.Outcome) -> None:
    """Check that a flight from Python and the run of a file are the same to the bit."""
    assert outcome.capture is not None
    ours, theirs = flight.tracking, outcome.capture.whole
    np.testing.assert_array_equal(flight.plan.q, outcome.trajectory.q)
    for name in ("t", "q", "v", "tau", "client_pose", "contact_wrench", "position_error", "momentum"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    assert flight.states == [(phase.time, phase.name, phase.reason) for phase in outcome.capture.phases]
    assert flight.note == outcome.note
    assert ours.note == theirs.note
    assert flight.captured.numbers() == outcome.capture.numbers()


@pytest.fixture(scope="module")
def rigid() -> capture.Flight:
    sms, q0, client = _servicer_and_client()
    goal = opt.Meet(client, GRASP, standoff=0.05)
    planning, procedure = capture.Planning(dt=0.02), capture.Procedure(after=1.0)
    return capture.fly(sms, q0, goal, 6.0, control=LAW, planning=planning, procedure=procedure)


def test_a_rigid_capture_equals_that_of_a_file(rigid: capture.Flight, tmp_path: Path) -> None:
    _check_equal(rigid, scenarios.run(scenarios.scenario(write(tmp_path, CAPTURE.replace("= 4.0", "= 1.0")))))


def test_a_flight_reports_its_outcome_and_phases(rigid: capture.Flight) -> None:
    assert rigid.latched
    assert rigid.outcome == "latched"
    assert [name for _, name, _ in rigid.states] == ["approach", "closing", "contact", "braking", "rest"]
    assert rigid.tracking.t[0] == 0.0
    assert rigid.tracking.t[-1] == pytest.approx(7.0)
    assert rigid.momentum_error < 1e-9
    rate = rigid.captured.found_rate
    np.testing.assert_allclose(rigid.prediction.rate(1.0), rate, atol=1e-4)
    assert np.linalg.norm(rate) > 1e-3
    assert repr(rigid) == "Flight(latched, 7 s)"


def test_the_plan_of_an_earlier_flight_is_flown(rigid: capture.Flight) -> None:
    sms, q0, client = _servicer_and_client()
    goal, planning = opt.Meet(client, GRASP, standoff=0.05), capture.Planning(dt=0.02)
    procedure = capture.Procedure(after=0.1, attempts=1)
    options: dict[str, Any] = {"control": LAW, "planning": planning, "procedure": procedure}
    shares: list[float] = []
    again = capture.fly(sms, q0, goal, 6.0, plan=rigid.plan, progress=shares.append, **options)
    rows = len(again.tracking.t)
    np.testing.assert_array_equal(again.tracking.q, rigid.tracking.q[:rows])
    assert shares[-1] == 1.0
    # A grasp outside the envelope is not attempted, and the outcome has the reason.
    narrow = capture.fly(
        sms, q0, goal, 6.0, plan=rigid.plan, envelope=capture.Envelope(distance=1e-9), **options
    )
    assert not narrow.latched
    assert narrow.outcome.startswith("no go: the grasp would be missed by")
    with pytest.raises(InvalidValue, match=r"plan.duration must equal the argument duration, 7 s, got 6"):
        capture.fly(sms, q0, goal, 7.0, plan=rigid.plan)
    with pytest.raises(InvalidValue, match=r"plan.q\[0\] must equal q0"):
        capture.fly(sms, sms.configuration(np.array(START) + 0.1), goal, 6.0, plan=rigid.plan)


def test_a_capture_stops_when_planning_fails_repeatedly(monkeypatch: pytest.MonkeyPatch) -> None:
    sms, q0, client = _servicer_and_client()
    step = opt.Replanning._stepped

    def stepped(self: opt.Replanning, *values: Any) -> tuple[Any, bool]:
        rates, solved = step(self, *values)
        return rates, solved and self._now < 0.5

    monkeypatch.setattr(opt.Replanning, "_stepped", stepped)
    flight = capture.fly(
        sms,
        q0,
        opt.Meet(client, GRASP, standoff=0.05),
        6.0,
        control=LAW,
        replan=capture.Replan(dt=0.04, period=2.0),
        procedure=capture.Procedure(after=0.1, attempts=1),
    )
    assert flight.tracking.stopped == "stopped at 0.88 s: 10 planning steps in a row were not solved"
    assert "10 planning steps in a row were not solved" in flight.outcome


def test_a_floating_plan_under_a_law_that_holds_the_base_is_warned_about() -> None:
    sms, q0, client = _servicer_and_client()
    wheels = ffsms.ReactionWheels(np.eye(3), 0.05, torque=1.0, momentum=60.0)
    held = sms.with_actuators(wheels=wheels)
    control = replace(LAW, base=QuaternionFeedback)
    with pytest.raises(FfsmsWarning, match="QuaternionFeedback holds the base's attitude"):
        capture.fly(
            held, q0, opt.Meet(client, GRASP), 6.0, control=control, planning=capture.Planning(dt=0.1)
        )


def test_the_limits_of_the_plan_are_judged_up_to_the_contact(rigid: capture.Flight) -> None:
    from ffsms_pin.capture.recording import _limit_misses

    assert rigid.tracking.arrived
    plan, problem = rigid.plan, rigid.plan.problem
    assert problem is not None
    top = float(plan.end_effector[:, 2].max())
    for height, kept in ((top + 0.01, True), (top - 0.01, False)):
        limited = replace(problem, limits=[*problem.limits, Below(height)])
        mission: Any = SimpleNamespace(plan=replace(plan, problem=limited))
        misses = _limit_misses(rigid.captured, mission, rigid.plant)
        assert (misses == []) == kept
    assert re.match(r"the limit 'ceiling' is violated by 0.01\d* m at", misses[0])


def test_after_an_abort_the_joints_brake_before_their_stops() -> None:
    """The first motion out of the corridor would leave a joint at 1.3 rad/s, 0.38 rad before its stop."""
    sms = ffsms.load("satellite_panda")
    end = sms.at(sms.configuration([0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9])).end_effector_pose
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], end * GRASP.inverse(), [0.0, 0.0, 0.0, 0.0, 0.02, 0.0])
    flight = capture.fly(
        sms,
        sms.configuration(START),
        opt.Meet(client, GRASP, standoff=0.05),
        6.0,
        envelope=capture.Envelope(distance=1e-9),
        control=replace(LAW, dt=0.01),
        planning=capture.Planning(dt=0.05, obstacles=[opt.Obstacle.box(BOX, on=client)]),
        procedure=capture.Procedure(attempts=1, after=0.1),
    )
    assert [name for _, name, _ in flight.states] == ["approach", "retreat", "retreat", "braking", "rest"]
    assert not flight.tracking.stopped
    joints = np.array([sms.layout.positions(q) for q in flight.tracking.q])
    assert (sms.limits.violation(joints) == 0.0).all()


@pytest.mark.slow
@pytest.mark.long
def test_a_compliant_capture_with_a_camera_equals_that_of_a_file(tmp_path: Path) -> None:
    """The client is measured late and noisily, its body is an obstacle, and the motion is re-planned."""
    text = CAPTURE.replace("= 4.0", '= 1.0\nkind = "compliant"\nstiffness = 400.0').replace(
        "[meet]",
        "[client.sensor]\nlatency = 0.2\nattitude_noise_deg = 0.3\n"
        "[client.belief]\nmass = 85.0\nmass_deviation = 0.1\n"
        '[[obstacle]]\non = "client"\nshape = "box"\nsize = [0.5, 0.6, 0.7]\n'
        '[reference]\nkind = "re-planning"\ndt = 0.04\nperiod = 0.2\n[meet]',
    )
    outcome = scenarios.run(scenarios.scenario(write(tmp_path, text)))
    sms, q0, client = _servicer_and_client()
    flight = capture.fly(
        sms,
        q0,
        opt.Meet(client, GRASP, standoff=0.05),
        6.0,
        camera=capture.Camera(latency=0.2, attitude_noise=math.radians(0.3)),
        belief=capture.Belief(mass=85.0, mass_deviation=0.1),
        grip=capture.Grip(stiffness=400.0),
        control=LAW,
        replan=capture.Replan(dt=0.04, period=0.2),
        planning=capture.Planning(dt=0.02, obstacles=[opt.Obstacle.box(BOX, on=client)]),
        procedure=capture.Procedure(after=1.0),
    )
    _check_equal(flight, outcome)
    assert flight.latched
    assert flight.prediction.load is not None


@pytest.mark.long
@pytest.mark.slow
def test_a_capture_with_a_nozzle_equals_that_of_a_file(tmp_path: Path) -> None:
    """Follow a plan made once to a known client, with a plant off by a tenth and with joint friction."""
    text = packaged_path("nozzle").read_text("utf-8").replace("half_angle_deg = 3.0", "half_angle_deg = 6.0")
    start = "[0.0, -20.0, -20.0, 90.0, 20.0, -60.0, -60.0]"
    packaged = "[30.0, -35.0, -40.0, 115.0, 25.0, -60.0, -80.0]"
    assert packaged in text
    text = text.replace(packaged, start)
    text = text.replace("K_p = 49.0", "K_p = 2.0").replace("K_d = 14.0", "K_d = 2.8")
    text = re.sub(
        r"^(reach = 0.1|misalignment_deg = 20.0|coulomb = 0.8|viscous = 4.0) .*\n", "", text, flags=re.M
    )
    for name in ("client.sensor", "client.belief", "reference"):
        text = re.sub(rf"^\[{re.escape(name)}\]\n(?:[^\[\n].*\n|\n)*", "", text, flags=re.M)
    text = text.replace("after = 10.0", "after = 0.5").replace("dt = 0.005 ", "dt = 0.01 ")
    outcome = scenarios.run(scenarios.scenario(write(tmp_path, text)))
    sms = ffsms.load("servicer")
    q0 = sms.configuration(_radians(0.0, -20.0, -20.0, 90.0, 20.0, -60.0, -60.0))
    grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.5242]))
    joints, size = _radians(14.0, 14.0, -30.0, 51.0, 34.0, -32.0, -78.0), [1.9, 1.5, 2.8]
    twist = [0.0, 0.0, 0.0, *_radians(1.94, 0.16, -2.28)]
    body = (1050.0, [1792.4, 2015.6, 630.7])
    client = _reached(sms, q0, joints, 60.0, grasp, body, twist, [coal.Box(*size)])
    (plant,) = simulation.random_plants(sms, np.random.default_rng(1), 1, 0.1, 0.1, 0.1)
    uneven = 0.1 / math.sqrt(3.0)
    flight = capture.fly(
        sms,
        q0,
        opt.Meet(client, grasp, standoff=0.55, half_angle=math.radians(6.0), tolerance=0.002),
        60.0,
        grip=capture.Grip(1000.0, 500.0, 500.0, 200.0, time=1.0),
        guide=capture.Nozzle(friction=0.1),
        envelope=capture.Envelope(0.04, math.radians(3.0), 0.03, math.radians(2.0)),
        control=capture.Control(partial(ComputedTorque, K_p=2.0, K_d=2.8, adaptive=False), dt=0.01),
        plant=plant,
        conditions=capture.Conditions(
            friction=simulation.JointFriction(coulomb=1.0, viscous=5.0),
            sensors=simulation.Sensors(joint_noise=1e-5, base_latency=0.01),
        ),
        planning=capture.Planning(dt=0.1, obstacles=[opt.Obstacle.box(size, on=client, name="client body")]),
        procedure=capture.Procedure(after=0.5, masses=capture.MassUncertainty(uneven, uneven, uneven)),
    )
    _check_equal(flight, outcome)
    assert flight.latched
    assert len(flight.client.shapes) == 1 + 9  # its body, eight sides and a floor
    assert len(client.shapes) == 1  # the caller's client is unchanged


def _radians(*degrees: float) -> list[float]:
    return [math.radians(angle) for angle in degrees]


@pytest.mark.parametrize(
    ("kind", "make"),
    [(capture.Nozzle, capture.probe_in_nozzle), (capture.Ring, capture.gripper_on_ring)],
)
def test_a_guide_has_the_defaults_of_its_scene(kind: type, make: Callable[..., capture.Scene]) -> None:
    """Sizes have the defaults of the function, surfaces those of `SurfaceContact`."""
    surface = inspect.signature(capture.SurfaceContact).parameters
    parameters = {**surface, **inspect.signature(make).parameters}
    assert {name: parameters[name].default for name in asdict(kind())} == asdict(kind())


class _Call:
    """A call of `fly` with valid arguments, some of them replaced."""

    sms, q0, client = _servicer_and_client(1.0)
    goal = opt.Meet(client, GRASP)

    @classmethod
    def call(cls, **changes: Any) -> Any:
        arguments = {"sms": cls.sms, "q0": cls.q0, "goal": cls.goal, "duration": 1.0} | changes
        return capture.fly(**arguments)


# A client whose body is where the arm starts.
INSIDE = ffsms.Client(80.0, [6.0, 9.0, 11.0], _Call.sms.at(_Call.q0).end_effector_pose)
OTHER = replace(_Call.goal, client=ffsms.Client(1.0, [1.0, 1.0, 1.0])).client


@pytest.mark.parametrize(
    ("changes", "fragments"),
    [
        ({"goal": pin.SE3.Identity()}, ["goal must be opt.Meet(client, grasp)", "opt.plan"]),
        ({"goal": [1.0, 0.0, 0.0]}, ["goal must be opt.Meet(client, grasp)"]),
        ({"goal": OTHER}, ["goal must be opt.Meet(client, grasp)"]),
        ({"duration": 0.0}, ["duration must be above zero [s], got 0"]),
        ({"duration": "long"}, ["duration", "'long'"]),
        ({"q0": START}, ["q0 must have 14 entries", "sms.configuration(joints)"]),
        ({"sms": "satellite_panda"}, ["sms must be a SpaceManipulator"]),
        ({"belief": capture.Belief()}, ["belief requires a camera: add camera=capture.Camera()"]),
        ({"camera": True}, ["camera must be a Camera or None, got True"]),
        ({"grip": capture.GripLoad(GRASP)}, ["grip must be a Grip"]),
        ({"guide": "nozzle"}, ["guide must be a Nozzle or a Ring or None, got 'nozzle'"]),
        ({"envelope": 0.05}, ["envelope must be an Envelope or None, got 0.05"]),
        (
            {"control": ComputedTorque(_Call.sms)},
            ["control must be a capture.Control, or a function", "control=lambda robot"],
        ),
        ({"control": lambda robot: "pd"}, ["control law must be a JointLaw, got 'pd'"]),
        ({"conditions": {"friction": None}}, ["conditions must be a Conditions or None"]),
        ({"plant": "servicer"}, ["plant must be a SpaceManipulator, got 'servicer'"]),
        ({"plant_q0": START}, ["plant_q0 must have 14 entries"]),
        (
            {
                "goal": opt.Meet(INSIDE, GRASP),
                "planning": capture.Planning(obstacles=[opt.Obstacle.box(BOX, on=INSIDE)]),
            },
            ["q0", "overlap by", "mm at the start", "change q0 or the client"],
        ),
        ({"replan": 0.1}, ["replan must be a ReplanOptions or", "got 0.1"]),
        ({"planning": {"dt": 0.1}}, ["planning must be a Planning"]),
        ({"procedure": 2}, ["procedure must be a Procedure or None, got 2"]),
        ({"plan": "plan.npz"}, ["plan must be a Trajectory, got 'plan.npz'"]),
        ({"progress": 1.0}, ["progress must be a function or None"]),
        (
            {"conditions": capture.Conditions(events=[simulation.Latch(0.5)])},
            ["conditions.events must be joint faults or payloads", "latches its gripper", "Latch(time=0.5)"],
        ),
        (
            {"planning": capture.Planning(mode="rotation-flying")},
            [
                "planning.mode requires a base law",
                "control.QuaternionFeedback",
                "rotation-flying",
            ],
        ),
        (
            {"control": capture.Control(base=QuaternionFeedback)},
            ["must have wheels or thrusters: sms.with_actuators(wheels=...)"],
        ),
        (
            {"planning": capture.Planning(wheel_momentum=[1.0, 0.0, 0.0])},
            ["wheel_momentum must be left out: no wheels hold the attitude (mode 'floating')"],
        ),
        ({"planning": capture.Planning(locked=["elbow"])}, ["locked[0]", "panda_joint1", "got 'elbow'"]),
        (
            {"planning": capture.Planning(obstacles=[opt.Obstacle.box(BOX, on=OTHER)])},
            ["obstacle 'box 1': on must be 'inertial', 'base', or the client of the goal, got Client("],
        ),
    ],
)
def test_invalid_arguments_of_fly_are_refused(
    refused: Refused, changes: dict[str, Any], fragments: list[str]
) -> None:
    refused(lambda: _Call.call(**changes), InvalidValue, *fragments)


@pytest.mark.parametrize(
    ("make", "fragments"),
    [
        (lambda: capture.Grip(stiffness=0.0), ["stiffness must be above zero [N/m], got 0"]),
        (lambda: capture.Grip(time=-1.0), ["time must be above zero [s], got -1"]),
        (lambda: capture.Nozzle(throat_radius=0.2), ["throat_radius must lie between"]),
        (lambda: capture.Belief(mass=-1.0), ["belief mass must be above zero [kg], got -1"]),
        (lambda: capture.Belief(inertia_deviation=1.0), ["belief inertia_deviation", "got 1"]),
        (lambda: capture.Planning(dt=0.0), ["planning dt must be above zero [s], got 0"]),
        (lambda: capture.Planning(limits=[0.1]), ["planning limits[0] must be a Limit, got 0.1"]),  # type: ignore[list-item]
        (lambda: capture.Procedure(attempts=0), ["procedure attempts must be a whole number of at least 1"]),
        (lambda: capture.Procedure(after=-1.0), ["procedure after", "[s], got -1"]),
        (lambda: capture.Replan(dt=0.0), ["replan dt must be above zero [s], got 0"]),
        (lambda: capture.Control(dt=0.0), ["control dt must be above zero [s], got 0"]),
        (lambda: capture.Control(base=3), ["control base must be a function from a robot"]),  # type: ignore[arg-type]
    ],
)
def test_options_are_checked_where_they_are_made(
    refused: Refused, make: Callable[[], Any], fragments: list[str]
) -> None:
    refused(make, InvalidValue, *fragments)


def test_a_camera_implies_re_planning_unless_it_is_switched_off() -> None:
    from ffsms_pin.capture.fly import _replan

    def options(replan: Any, camera: bool) -> dict[str, Any]:
        chosen = _replan(replan, camera)
        assert chosen is not None
        return asdict(chosen)

    assert _replan(None, False) is None
    assert options(None, True) == asdict(capture.Replan())
    assert _replan(False, True) is None
    assert options(opt.ReplanOptions(period=0.3), False) == asdict(capture.Replan(period=0.3))
