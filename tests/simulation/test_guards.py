"""Guards of a flight: each limit trips with its value, the joints are braked, and the recording is saved."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import START, Constant, Swing
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.control import ComputedTorque, QuaternionFeedback, StoppingLaw
from ffsms_pin.errors import SimulationDiverged
from ffsms_pin.simulation import (
    Actuator,
    Capture,
    Close,
    Conditions,
    Freeze,
    Guards,
    Instant,
    JointFault,
    JointFriction,
    Observer,
    Phase,
    Supervisor,
    Tracking,
    Trip,
    Wrench,
    WristSensor,
    perturb,
    simulate,
)

Array = NDArray[np.float64]
OFF: dict[str, Any] = dict.fromkeys(
    ("position_margin", "rate_margin", "saturation", "joint_error", "base_rate", "energy", "failed_steps")
)


def only(**limits: Any) -> Guards:
    """Return guards with the given limits alone."""
    return Guards(**{**OFF, **limits})


def stop_time(tracking: Tracking) -> float:
    return float(tracking.stopped.split()[2])


def joint_rates(tracking: Tracking) -> Array:
    return np.abs(tracking.v[:, 6:])


# -- the law that brakes ----------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["planar_3r", "satellite_panda", "servicer"])
def test_braking_never_puts_energy_in(robot: str, rng: np.random.Generator) -> None:
    sms = ffsms.load(robot)
    for _ in range(40):
        model = perturb(
            sms, arm_mass=rng.uniform(0.3, 3.0, sms.n), base_mass=rng.uniform(0.3, 3.0)
        )  # whatever the masses are
        q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))
        v = rng.normal(size=6 + sms.n)
        limp = rng.random(sms.n) < 0.2
        unlimited = np.abs(StoppingLaw(model, 1e-3).torque(q, v))
        limit = unlimited * 10.0 ** rng.uniform(-3.0, 0.5, sms.n)
        tau = StoppingLaw(model, 1e-3, limit).torque(q, v, limp)
        assert (np.abs(tau) <= limit).all()
        assert (tau[limp] == 0.0).all()
        assert tau @ v[6:] < 0.0


def test_braking_torques_are_the_nearest_within_their_limits(
    rng: np.random.Generator,
) -> None:
    from scipy.optimize import lsq_linear

    panda = ffsms.load("satellite_panda")
    for _ in range(10):
        q = panda.configuration(np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0]) + rng.uniform(-0.5, 0.5, 7))
        v = 0.1 * rng.normal(size=6 + panda.n)
        unlimited = StoppingLaw(panda, 1e-3).torque(q, v)
        limit = np.abs(unlimited) * rng.uniform(0.2, 1.5, panda.n)
        tau = StoppingLaw(panda, 1e-3, limit).torque(q, v)
        W = np.linalg.inv(np.linalg.cholesky(panda.at(q).H_q))
        best = lsq_linear(W, W @ unlimited, (-limit, limit), tol=1e-14).x
        assert np.linalg.norm(W @ (tau - unlimited)) <= np.linalg.norm(W @ (best - unlimited)) * (1.0 + 1e-6)


def test_joints_slow_down_alike_and_stop_before_their_stops(planar: ffsms.SpaceManipulator) -> None:
    law = StoppingLaw(planar, 1e-3)
    q, v = planar.configuration(START), planar.velocity(planar.configuration(START), [0.01, -0.02, 0.015])
    slower = planar.at(q, v).H_q @ v[6:]
    np.testing.assert_allclose(law.torque(q, v), -slower / 0.5, rtol=1e-12)
    near = planar.limits.upper - np.array([0.02, 1.0, 1.0])
    q = planar.configuration(near)
    v = planar.velocity(q, [0.3, 0.0, 0.0])
    still, conditions = Swing(planar, np.zeros(3), 3.0, near), Conditions(v0=v, events=Freeze(0.0))
    tracking = simulate(planar, still, Constant(np.zeros(3)), q0=q, conditions=conditions)
    joints = np.array([planar.joint_positions(row) for row in tracking.q])
    assert joints[:, 0].max() < planar.limits.upper[0]
    assert joint_rates(tracking)[-1].max() < 1e-4
    assert np.diff(tracking.kinetic_energy).max() < 1e-15


def test_joints_with_an_unknown_payload_slow_down_alike() -> None:
    """Without the measured rates in the law the wrist runs on while the other joints stop."""
    sms = ffsms.load("satellite_z1")
    q0 = sms.configuration([0.3, 1.2, -1.0, 0.2, 0.3, -0.2])
    v0 = sms.velocity(q0, [0.5, -0.3, 0.4, 0.3, -0.3, 0.5])
    events: list[Any] = [Capture(0.0, 10.0, 0.1 * np.eye(3)), Freeze(0.0)]
    still = Swing(sms, np.zeros(6), 3.0, sms.joint_positions(q0))
    conditions = Conditions(v0=v0, events=events, friction=JointFriction())
    rates = joint_rates(simulate(sms, still, Constant(np.zeros(6)), 2e-3, q0, conditions=conditions))
    assert (rates.max(axis=0) < 1.1 * rates[0]).all()
    assert rates[-1].max() < 0.02


def test_joints_slow_down_alike_beside_a_limp_joint(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration(START)
    v0 = planar.velocity(q0, [0.1, 0.1, -0.15])
    events: list[Any] = [JointFault(0.0, 1, "limp"), Freeze(0.0)]
    hold = Swing(planar, np.zeros(3), 2.0, START)
    rates = joint_rates(
        simulate(planar, hold, Constant(np.zeros(3)), 2e-3, q0, conditions=Conditions(v0=v0, events=events))
    )
    expected = np.exp(-2.0 * np.arange(len(rates)) * 2e-3)[:, None] * rates[0]
    np.testing.assert_allclose(rates[:, [0, 2]], expected[:, [0, 2]], atol=0.02 * rates[0].max())
    assert rates[-1, 1] > 0.01


# -- each guard -------------------------------------------------------------------------------------------


class Hold(Swing):
    """A reference at rest."""

    def __init__(self, sms: ffsms.SpaceManipulator, joints: Any = START, duration: float = 4.0) -> None:
        super().__init__(sms, np.zeros(sms.n), duration, joints)


def test_a_stop_trips_before_it_is_hit(planar: ffsms.SpaceManipulator) -> None:
    start = np.array([planar.limits.upper[0] - 0.1, 0.5, 0.5])
    q0 = planar.configuration(start)
    run: dict[str, Any] = {"q0": q0, "v0": planar.velocity(q0, [0.2, 0.0, 0.0]), "dt": 5e-3}
    limits = planar.limits

    def farthest(tracking: Tracking) -> float:
        return max(float(limits.violation(planar.joint_positions(q)).max()) for q in tracking.q)

    still = Constant(np.zeros(3))
    free = simulate(planar, Hold(planar, start), still, guards=None, **run)
    assert farthest(free) > 0.3
    assert free.stopped == ""
    guarded = simulate(planar, Hold(planar, start), still, guards=only(position_margin=1e-3), **run)
    assert "joint 'joint_1' is too fast to brake before its stop" in guarded.stopped
    assert farthest(guarded) == 0.0
    assert not guarded.arrived
    assert guarded.note.startswith(f"not arrived: {guarded.stopped}")
    # A joint may move into the margin, but not beyond it.
    loose = planar.with_limits(replace(planar.limits, acceleration=np.full(3, np.inf)))
    late = simulate(loose, Hold(planar, start), still, guards=only(position_margin=1e-2), **run)
    assert "beyond its stop at" in late.stopped
    assert 1e-3 < farthest(late) < 1e-2


def test_a_rate_trips_and_falls(planar: ffsms.SpaceManipulator) -> None:
    law = Constant([0.0, 0.02, 0.0])
    run: dict[str, Any] = {"dt": 2e-3}
    limit = planar.limits.velocity
    free = simulate(planar, Hold(planar), law, guards=None, **run)
    assert (joint_rates(free) / limit).max() > 3.0
    guarded = simulate(planar, Hold(planar), law, guards=only(rate_margin=0.02), **run)
    assert "its limit is 0.4 rad/s" in guarded.stopped
    assert (joint_rates(guarded) / limit).max() < 1.05
    assert joint_rates(guarded)[-1].max() < 1e-3
    k = int(np.searchsorted(guarded.t, stop_time(guarded)))
    assert np.diff(guarded.kinetic_energy[k:]).max() <= 0.0


def test_a_joint_at_its_torque_limit_trips(planar: ffsms.SpaceManipulator) -> None:
    swing, law = Swing(planar, duration=4.0), ComputedTorque(planar)
    most = np.abs(simulate(planar, swing, law, dt=5e-3).tau).max(axis=0)
    weak = Actuator(torque_limit=0.3 * most)
    guarded = simulate(planar, swing, law, dt=5e-3, conditions=Conditions(actuator=weak))
    assert "at its torque limit for 0.3 s" in guarded.stopped
    assert "N m)" in guarded.stopped
    assert (np.abs(guarded.tau) <= 0.3 * most).all()
    assert joint_rates(guarded)[-1].max() < 1e-3
    # The law's own limit counts, too, and the robot's if a law has none.
    own = ComputedTorque(planar, torque_limit=0.3 * most)
    assert simulate(planar, swing, own, dt=5e-3).stopped == guarded.stopped
    robot = planar.with_limits(replace(planar.limits, torque=0.3 * most))

    class Plain:
        def torque(self, *state: Any) -> Array:
            return law.torque(*state)

    assert "at its torque limit for 0.3 s" in simulate(robot, swing, Plain(), dt=5e-3).stopped
    # Without the guard the run continues, and the note reports the time at the limit.
    free = simulate(
        planar, swing, own, dt=5e-3, conditions=Conditions(guards=Guards(saturation=None, joint_error=None))
    )
    assert free.stopped == ""
    assert "% of the time)" in free.note
    assert "was at its torque limit of" in free.note


def test_time_below_the_torque_limit_offsets_time_at_it(planar: ffsms.SpaceManipulator) -> None:
    class Pulses:
        """A law at its limit in `on` of ten steps, with alternating signs so that the joint stays."""

        torque_limit = np.array([1.0, 1.0, 1e-4])

        def __init__(self, on: int) -> None:
            self.on, self.k = on, -1

        def torque(self, *state: Any) -> Array:
            self.k += 1
            return np.array([0.0, 0.0, 1e-4 * (-1.0) ** self.k * (self.k % 10 < self.on)])

    frequent = simulate(planar, Hold(planar), Pulses(9), dt=2e-3)
    assert "joint 'joint_3' at its torque limit for 0.3 s (0.0001 N m)" in frequent.stopped
    assert 0.3 < stop_time(frequent) < 0.4
    rare = simulate(planar, Hold(planar), Pulses(4), dt=2e-3)
    assert rare.stopped == ""
    assert "joint 'joint_3' was at its torque limit of 0.0001 N m for 1.6 s in all (40 % of" in rare.note


def test_a_joint_off_its_reference_trips(planar: ffsms.SpaceManipulator) -> None:
    swing, law = Swing(planar, displacement=(1.2, 0.0, 0.0), duration=8.0), Constant(np.zeros(3))
    guarded = simulate(planar, swing, law, dt=5e-3)
    assert "joint 'joint_1' is 1" in guarded.stopped
    assert "off its reference, 1 rad are allowed" in guarded.stopped
    free = simulate(planar, swing, law, dt=5e-3, conditions=Conditions(guards=Guards(joint_error=math.inf)))
    assert free.stopped == ""
    assert np.abs(free.joint_error).max() > 1.1


def test_a_base_that_turns_too_fast_trips(planar: ffsms.SpaceManipulator) -> None:
    push = Wrench([0.0, 0.0, 0.0, 0.0, 0.0, 1.5])
    law = ComputedTorque(planar)
    free = simulate(planar, Hold(planar), law, dt=5e-3, conditions=Conditions(disturbances=push, guards=None))
    assert np.abs(free.v[:, 5]).max() > 1.2
    guarded = simulate(
        planar,
        Hold(planar),
        law,
        dt=5e-3,
        conditions=Conditions(disturbances=push, guards=only(base_rate=1.0)),
    )
    assert "the base turns at 1" in guarded.stopped


def test_energy_that_is_pumped_in_trips(planar: ffsms.SpaceManipulator) -> None:
    """A derivative gain of the wrong sign: the joints swing ever faster, within their other limits."""

    class Pumping:
        def torque(self, q: Array, v: Array, q_d: Array, qd_d: Array, qdd_d: Array) -> Array:
            return 0.1 * (q_d - q[7:]) + 0.02 * v[6:]

    q0 = planar.configuration(START + 0.02)
    robot = planar.with_limits(replace(planar.limits, velocity=np.full(3, 2.0)))
    free = simulate(robot, Hold(planar), Pumping(), dt=2e-3, q0=q0, conditions=Conditions(guards=None))
    guarded = simulate(
        robot, Hold(planar), Pumping(), dt=2e-3, q0=q0, conditions=Conditions(guards=only(energy=1.0))
    )
    assert "the kinetic energy of the joint motion is" in guarded.stopped
    k = int(np.searchsorted(guarded.t, stop_time(guarded)))
    assert guarded.kinetic_energy.max() <= guarded.kinetic_energy[k] < 0.1 * free.kinetic_energy.max()
    assert np.diff(guarded.kinetic_energy[k:]).max() <= 0.0


def test_planning_steps_that_fail_trip(planar: ffsms.SpaceManipulator, law: ComputedTorque) -> None:
    class Failing(Swing, Observer):
        failed_in_a_row = 0

        def observe(self, t: float, q: Array, v: Array) -> None:
            self.failed_in_a_row = max(0, round((t - 0.5) / 0.1))

    guarded = simulate(
        planar, Failing(planar), law, dt=0.01, conditions=Conditions(guards=Guards(failed_steps=4))
    )
    assert "4 planning steps in a row were not solved" in guarded.stopped
    assert stop_time(guarded) == pytest.approx(0.86, abs=0.011)
    assert (
        simulate(
            planar, Failing(planar), law, dt=0.01, conditions=Conditions(guards=Guards(failed_steps=None))
        ).stopped
        == ""
    )


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"guards": only(contact_force=1.0)}, "the contact force is 1.25 N, 1 N are allowed"),
        ({"guards": only(contact_torque=0.1)}, "the contact torque is"),
        ({"wrist": WristSensor(force_limit=1.0)}, "the contact force is 1.25 N, 1 N are allowed"),
        ({"weak": True}, "the contact loads joint 'panda_joint"),
        ({}, ""),
    ],
)
def test_a_contact_beyond_its_limits_trips(options: dict[str, Any], fragment: str) -> None:
    sms, joints = ffsms.load("satellite_panda"), np.array([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8])
    q0, weak = sms.configuration(joints), "weak" in options
    beside = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.05])), np.array([0.0, 0.0125, 0.0]))
    client = ffsms.Client(50.0, np.eye(3), sms.at(q0).end_effector_pose * beside)
    robot = sms.with_limits(replace(sms.limits, torque=np.full(7, 0.3))) if weak else sms
    run: dict[str, Any] = {"dt": 2e-3, "q0": q0, "client": client, "substeps": 4, **options}
    run["events"] = Close(0.1, GripLoad(pin.SE3.Identity(), 100.0, 10.0, 10.0, 1.0))
    run.pop("weak", None)
    tracking = simulate(robot, Hold(sms, joints, 1.0), ComputedTorque(sms), **run)
    assert fragment in tracking.stopped
    assert bool(tracking.stopped) == bool(fragment)
    if fragment:
        assert stop_time(tracking) == pytest.approx(0.1, abs=0.02)


# -- responses to a guard ---------------------------------------------------------------------------------


def test_an_arm_with_an_unknown_payload_and_a_limp_joint_is_brought_to_rest(
    planar: ffsms.SpaceManipulator, law: ComputedTorque
) -> None:
    limp = JointFault(0.7, 2, "limp", reported=False)
    events: list[Any] = [Capture(0.5, 30.0, np.eye(3)), limp, Freeze(1.2, "by hand")]
    swing, rub = Swing(planar, duration=6.0), JointFriction(viscous=0.02)
    tracking = simulate(planar, swing, law, dt=5e-3, conditions=Conditions(friction=rub, events=events))
    assert tracking.stopped == "stopped at 1.2 s: by hand"
    assert np.diff(tracking.kinetic_energy[240:]).max() <= 1e-15
    assert joint_rates(tracking)[240].max() > 0.05
    assert joint_rates(tracking)[-1].max() < 0.2 * joint_rates(tracking)[240].max()


def test_the_base_is_held_while_the_joints_are_braked(planar: ffsms.SpaceManipulator) -> None:
    wheels = ReactionWheels(axes=np.eye(3), inertia=0.01, momentum=5.0, torque=0.3)
    sms = planar.with_actuators(wheels=wheels)
    run: dict[str, Any] = {
        "base_controller": QuaternionFeedback(sms),
        "dt": 5e-3,
        "events": Freeze(1.0, "by hand"),
    }
    tracking = simulate(sms, Swing(sms, duration=20.0), ComputedTorque(sms), **run)
    assert tracking.stopped == "stopped at 1 s: by hand"
    assert joint_rates(tracking)[-1].max() < 1e-4
    assert tracking.base_rotation[-1] < 1e-3
    assert np.abs(tracking.wheel_torque[200:]).max() > 1e-5


def test_a_supervisor_decides_how_a_trip_is_handled(
    planar: ffsms.SpaceManipulator, law: ComputedTorque
) -> None:
    class Tolerant(Supervisor):
        """A supervisor that ignores the first trip and freezes at the second."""

        def __init__(self) -> None:
            self.model, self.trips = planar, list[Trip]()

        def decide(self, now: Instant) -> list[Any]:
            return []

        def guard_tripped(self, now: Instant, trip: Trip) -> list[Any]:
            self.trips.append(trip)
            again = len(self.trips) > 1
            return [Phase(now.t, "warned"), *([Freeze(now.t, trip.reason)] if again else [])]

    supervisor = Tolerant()
    swing = Swing(planar, displacement=(1.2, 0.0, 0.0), duration=8.0)
    run: dict[str, Any] = {"dt": 5e-3, "guards": only(joint_error=0.1)}
    tracking = simulate(planar, swing, Constant(np.zeros(3)), supervisor=supervisor, **run)
    assert [trip.guard for trip in supervisor.trips] == ["joint_error"] * 2
    assert tracking.note.count("warned") == 2
    assert "off its reference" in tracking.stopped

    class Plain(Supervisor):
        model = planar

        def decide(self, now: Instant) -> list[Any]:
            return []

    assert simulate(planar, swing, Constant(np.zeros(3)), supervisor=Plain(), **run).stopped


def test_a_stopped_flight_is_saved_with_its_reason(
    planar: ffsms.SpaceManipulator, law: ComputedTorque, tmp_path: Path
) -> None:
    path = tmp_path / "stopped.npz"
    run: dict[str, Any] = {"dt": 5e-3, "guards": only(rate_margin=0.02, path=path)}
    tracking = simulate(planar, Hold(planar), Constant([0.0, 0.02, 0.0]), **run)
    saved = Tracking.load(path)
    assert saved.stopped == tracking.stopped != ""
    assert saved.misses[0] == tracking.stopped
    assert not saved.arrived
    assert str(path) in tracking.note
    np.testing.assert_array_equal(saved.q, tracking.q)
    path = tmp_path / "diverged.npz"
    with pytest.raises(SimulationDiverged, match="recorded until then") as diverged:
        simulate(
            planar, Swing(planar), Constant([math.nan] * 3), conditions=Conditions(guards=Guards(path=path))
        )
    np.testing.assert_array_equal(Tracking.load(path).q, diverged.value.tracking.q)
    good = simulate(
        planar, Swing(planar), law, conditions=Conditions(guards=Guards(path=tmp_path / "unused.npz"))
    )
    assert len(good.t) == 2001
    assert not (tmp_path / "unused.npz").exists()
    assert good.stopped == ""
