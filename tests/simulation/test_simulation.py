"""The closed loop: tracking, conservation laws, model mismatch and divergence."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import START, Constant, Swing, arrays_of
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import SlidingModeController
from ffsms_pin.errors import FfsmsError, InvalidValue, SimulationDiverged
from ffsms_pin.simulation import Conditions, Observer, Tracking, simulate
from ffsms_pin.simulation.tracking import OPTIONAL, SHAPES

Array = NDArray[np.float64]
Refused = Callable[..., FfsmsError]


def heavier(sms: ffsms.SpaceManipulator, arm: float, base: float = 1.0) -> ffsms.SpaceManipulator:
    """Return the robot with scaled masses and inertias."""
    model = sms.model.copy()
    for j in range(1, model.njoints):
        factor = base if j == 1 else arm
        body = model.inertias[j]
        model.inertias[j] = pin.Inertia(factor * body.mass, body.lever, factor * body.inertia)
    return ffsms.SpaceManipulator(model, sms.end_effector, sms.base_size)


@pytest.mark.parametrize("target", [(1.0, 0.15, 0.0), (0.45, 0.75, 0.0)])
def test_paper_gains_track_a_whole_case(planar: ffsms.SpaceManipulator, target: tuple[float, ...]) -> None:
    plan = opt.plan(planar, planar.configuration(START), target, duration=12.0)
    tracking = simulate(planar, plan, SlidingModeController(planar))
    assert tracking.t[-1] == 12.0
    assert tracking.tau.shape == (12000, 3)
    assert np.abs(tracking.joint_error).max() < 1e-4
    assert np.abs(tracking.momentum).max() < 1e-12
    assert np.abs(tracking.energy_error).max() < 1e-6 * tracking.kinetic_energy.max()
    assert (np.abs(tracking.tau) <= planar.limits.torque).all()
    # The simulated free base moves as the momentum equation of the plan predicts.
    differences = [pin.difference(planar.model, *pair) for pair in zip(plan.q, tracking.q[::10], strict=True)]
    assert np.abs(differences).max() < 1e-4
    np.testing.assert_allclose(tracking.position_error[::10], plan.position_error, atol=1e-4)
    assert tracking.position_error[-1] < 1e-3


def test_paper_gains_leave_an_initial_error_and_larger_ones_remove_it(
    planar: ffsms.SpaceManipulator,
) -> None:
    swing = Swing(planar, duration=12.0)
    q0 = planar.configuration(START + 0.02)
    ends = {}
    for K_s in (0.001, 0.01):
        controller = SlidingModeController(planar, K_s=K_s)
        tracking = simulate(planar, swing, controller, 2e-3, q0)
        np.testing.assert_allclose(tracking.joint_error[0], 0.02, atol=1e-15)
        ends[K_s] = np.abs(tracking.joint_error[-1]).max(), controller.time_constants(q0).max()
        assert np.abs(tracking.momentum).max() < 1e-12
    assert ends[0.001][0] > 0.015  # as much as there was, after 12 s
    assert ends[0.001][1] > 5.0
    assert ends[0.01][0] < 1e-4
    assert ends[0.01][1] < 1.0


def test_error_in_the_boundary_layer_decays_with_the_time_constants(
    planar: ffsms.SpaceManipulator,
) -> None:
    hold = Swing(planar, np.zeros(3), duration=0.3)
    controller = SlidingModeController(planar, K_s=0.01, Gamma=2.0)
    q0 = planar.configuration(START + np.array([2e-3, -1e-3, 3e-3]))
    tracking = simulate(planar, hold, controller, q0=q0)
    s = tracking.joint_rate_error + 2.0 * tracking.joint_error
    # ds/dt = -H_q^-1 K_s s / boundary, with the H_q of a posture that hardly changes.
    rates, modes = np.linalg.eig(np.linalg.inv(planar.at(q0).H_q) * 0.01 / 0.02)
    decay = (modes * np.exp(-rates * tracking.t[-1])) @ np.linalg.inv(modes)
    np.testing.assert_allclose(s[-1], decay @ s[0], atol=0.01 * np.abs(s[0]).max())
    np.testing.assert_allclose(np.sort(1.0 / rates), controller.time_constants(q0), rtol=1e-9)


def test_recorded_rows_agree_with_the_state(
    planar: ffsms.SpaceManipulator, swing: Swing, swung: Tracking
) -> None:
    assert [len(getattr(swung, name)) for name in arrays_of(swung)] == [
        2000 if {**SHAPES, **OPTIONAL}[name][0] == "N" else 2001 for name in arrays_of(swung)
    ]
    assert swung.note.startswith("not arrived: the end effector ends 571 mm from its target")
    np.testing.assert_allclose(swung.t, 1e-3 * np.arange(2001), atol=1e-12)
    np.testing.assert_array_equal(swung.q[0], swing.q[0])
    for k in (0, 700, 1400, 2000):
        state = planar.at(swung.q[k], swung.v[k])
        np.testing.assert_allclose(swung.momentum[k], state.momentum, atol=1e-14)
        assert swung.kinetic_energy[k] == pytest.approx(state.kinetic_energy, abs=1e-15)
        distance = np.linalg.norm(swing.target - state.end_effector_pose.translation)
        assert swung.position_error[k] == pytest.approx(distance, abs=1e-14)
        q_d, qd_d, _ = swing.sample(swung.t[k])
        np.testing.assert_allclose(swung.joint_error[k], swung.q[k, 7:] - q_d, atol=1e-15)
        np.testing.assert_allclose(swung.joint_rate_error[k], swung.v[k, 6:] - qd_d, atol=1e-15)
    assert np.abs(swung.joint_error).max() < 1e-4


def test_work_is_torque_times_travel(swung: Tracking) -> None:
    # Each torque is held over its step, so its work is torque times joint travel, whatever happens between.
    steps = (swung.tau * np.diff(swung.q[:, 7:], axis=0)).sum(axis=1)
    assert np.abs(swung.work).max() > 1e-4
    np.testing.assert_allclose(swung.work[1:], np.cumsum(steps), atol=1e-15)
    assert np.abs(swung.energy_error).max() < 1e-6 * swung.kinetic_energy.max()


def test_base_stays_free_in_space_with_momentum(random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(11, 4, ("revolute", "continuous")).model(), "tip")
    swing = Swing(sms, [0.5, -0.4, 0.6, 0.3], 1.0, start=np.zeros(4))
    momentum = np.array([0.5, -0.3, 0.2, 1.0, -2.0, 1.5])
    v0 = sms.velocity(swing.q[0], np.zeros(4), momentum)
    controller = SlidingModeController(sms, K_s=1.0, torque_limit=np.inf)
    tracking = simulate(sms, swing, controller, conditions=Conditions(v0=v0))
    np.testing.assert_allclose(tracking.momentum, np.tile(momentum, (1001, 1)), atol=1e-11)
    gain = np.ptp(tracking.kinetic_energy)
    assert gain > 1e-2
    assert np.abs(tracking.energy_error).max() < 1e-6 * gain
    # The law needs no zero momentum: H_q and C_q are those of the measured velocity.
    assert np.abs(tracking.joint_error).max() < 1e-3


def test_a_wrong_mass_changes_the_errors_and_not_the_momentum(
    planar: ffsms.SpaceManipulator, swing: Swing, swung: Tracking
) -> None:
    plant = heavier(planar, arm=1.2, base=0.9)
    controller = SlidingModeController(planar)
    tracking = simulate(planar, swing, controller, plant=plant)
    assert np.abs(tracking.momentum).max() < 1e-12
    assert np.abs(tracking.energy_error).max() < 1e-6 * tracking.kinetic_energy.max()
    assert np.abs(tracking.joint_error).max() > 10.0 * np.abs(swung.joint_error).max()
    # The joints end within 10 mrad; the end effector does not, because the base reacts differently.
    assert np.abs(tracking.joint_error[-1]).max() < 0.01
    assert abs(tracking.position_error[-1] - swung.position_error[-1]) > 5e-3
    state = plant.at(tracking.q[-1], tracking.v[-1])
    assert tracking.kinetic_energy[-1] == pytest.approx(state.kinetic_energy, abs=1e-15)


def test_torque_limit_with_and_without(planar: ffsms.SpaceManipulator, swing: Swing) -> None:
    limit = np.array([0.05, 0.02, 0.01])
    free = simulate(planar, swing, SlidingModeController(planar, torque_limit=np.inf), dt=2e-3)
    limited = simulate(planar, swing, SlidingModeController(planar, torque_limit=limit), dt=2e-3)
    assert (np.abs(free.tau).max(axis=0) > limit).all()
    np.testing.assert_array_equal(np.abs(limited.tau).max(axis=0), limit)
    assert np.abs(limited.joint_error).max() > np.abs(free.joint_error).max()


def test_start_with_moving_joints_has_no_momentum(planar: ffsms.SpaceManipulator, swing: Swing) -> None:
    class Late(Swing):
        def sample(self, t: float) -> tuple[Array, Array, Array]:
            return swing.sample(t + 0.8)

    late = Late(planar, duration=0.2, start=swing.sample(0.8)[0])
    tracking = simulate(planar, late, SlidingModeController(planar))
    assert np.abs(tracking.v[0, 6:]).min() > 0.1
    assert np.abs(tracking.momentum).max() < 1e-14
    assert np.abs(tracking.joint_error).max() < 1e-4


def test_a_reference_observes_the_measured_state(planar: ffsms.SpaceManipulator) -> None:
    class Watching(Swing, Observer):
        seen: list[tuple[float, Array, Array]]

        def observe(self, t: float, q: Array, v: Array) -> None:
            self.seen.append((t, q.copy(), v.copy()))

        def sample(self, t: float) -> tuple[Array, Array, Array]:
            assert not self.seen or self.seen[-1][0] == t or t == self.duration  # the state comes first
            return super().sample(t)

    watching = Watching(planar, np.full(3, 0.1), duration=0.05)
    watching.seen = []
    tracking = simulate(planar, watching, SlidingModeController(planar), conditions=Conditions(guards=None))
    assert len(watching.seen) == 50
    for (t, q, v), *row in zip(watching.seen, tracking.t, tracking.q, tracking.v, strict=False):
        assert t == row[0]
        np.testing.assert_array_equal(q, row[1])
        np.testing.assert_array_equal(v, row[2])


def test_target_may_move_or_be_a_pose(planar: ffsms.SpaceManipulator) -> None:
    hold = Swing(planar, np.zeros(3), duration=0.1)
    at = planar.at(hold.q[0]).end_effector_pose.translation
    controller = SlidingModeController(planar)
    hold.target = lambda t: at + np.array([t, 0.0, 0.0])
    moving = simulate(planar, hold, controller, dt=0.01)
    np.testing.assert_allclose(moving.position_error, moving.t, atol=1e-12)
    hold.target = lambda t: pin.SE3(np.eye(3), at + np.array([0.0, 2.0 * t, 0.0]))
    np.testing.assert_allclose(simulate(planar, hold, controller, dt=0.01).position_error, 2.0 * moving.t)
    hold.target = pin.SE3(np.eye(3), at + np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(simulate(planar, hold, controller, dt=0.01).position_error, 1.0)


def test_the_attitude_of_a_moving_pose_counts(planar: ffsms.SpaceManipulator) -> None:
    hold = Swing(planar, np.zeros(3), duration=0.1)
    pose, controller = planar.at(hold.q[0]).end_effector_pose, SlidingModeController(planar)
    hold.target = lambda t: pose
    assert simulate(planar, hold, controller, dt=0.01).arrived
    hold.target = lambda t: pin.SE3(pose.rotation @ pin.exp3(np.array([0.0, 0.0, t])), pose.translation)
    turning = simulate(planar, hold, controller, dt=0.01)
    np.testing.assert_allclose(turning.orientation_error, turning.t, atol=1e-9)
    assert turning.misses == (
        "the end effector's attitude ends 5.73 deg from its target, 1.15 deg are allowed",
    )


def test_progress_rises_to_one(planar: ffsms.SpaceManipulator) -> None:
    shares: list[float] = []
    hold = Swing(planar, np.zeros(3), duration=0.5)
    simulate(planar, hold, SlidingModeController(planar), progress=shares.append)
    assert shares[-1] == 1.0
    assert np.all(np.diff(shares) > 0.0)
    assert 10 <= len(shares) <= 300


def test_step_is_the_nearest_that_fits(planar: ffsms.SpaceManipulator) -> None:
    hold = Swing(planar, np.zeros(3), duration=0.1)
    controller = SlidingModeController(planar)
    assert len(simulate(planar, hold, controller, dt=0.03).tau) == 3
    assert len(simulate(planar, hold, controller, dt=0.1).tau) == 1


def test_divergence_is_reported_with_the_recording(planar: ffsms.SpaceManipulator, swing: Swing) -> None:
    controller = SlidingModeController(planar, Gamma=1e5, torque_limit=np.inf)
    q0 = planar.configuration(START + 0.02)
    with pytest.raises(SimulationDiverged) as caught:
        simulate(planar, swing, controller, q0=q0, conditions=Conditions(guards=None))
    recording = caught.value.tracking
    assert isinstance(recording, Tracking)
    rows = len(recording.t)
    assert 1 < rows < 2001
    assert recording.t[-1] == caught.value.time
    assert recording.tau.shape == (rows - 1, 3)
    for name in arrays_of(recording):
        assert np.isfinite(getattr(recording, name)).all()
    assert "dt" in str(caught.value)


def test_torque_that_is_not_a_number_stops_at_once(planar: ffsms.SpaceManipulator, swing: Swing) -> None:
    with pytest.raises(SimulationDiverged) as caught:
        simulate(planar, swing, Constant([0.0, math.nan, 0.0]))
    assert caught.value.time == 0.0
    assert caught.value.tracking.q.shape == (1, 10)
    assert caught.value.tracking.tau.shape == (0, 3)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"dt": 0.0}, "dt"),
        ({"dt": math.nan}, "dt"),
        ({"dt": "fast"}, "dt"),
        ({"dt": 2.1}, "dt"),
        ({"q0": np.zeros(3)}, "q0"),
        ({"q0": np.full(10, math.nan)}, "q0"),
        ({"v0": np.zeros(3)}, "v0"),
    ],
)
def test_bad_arguments_are_refused(
    arguments: dict[str, Any], name: str, planar: ffsms.SpaceManipulator, swing: Swing, refused: Refused
) -> None:
    controller = SlidingModeController(planar)
    error = refused(lambda: simulate(planar, swing, controller, **arguments), InvalidValue)
    assert str(error).startswith(name)


def test_bad_references_and_controllers_are_refused(
    planar: ffsms.SpaceManipulator, random_tree: Callable[..., Any], refused: Refused
) -> None:
    controller = SlidingModeController(planar)

    def try_with(fragment: str, law: Any = controller, **change: Any) -> None:
        reference = Swing(planar, np.zeros(3))
        for name, value in change.items():
            setattr(reference, name, value)
        refused(lambda: simulate(planar, reference, law), InvalidValue, fragment)

    try_with("reference.duration", duration=0.0)
    try_with("reference.duration", duration=math.inf)
    try_with("target", target=np.zeros(2))
    try_with("target", target=lambda t: np.zeros(4))
    try_with("q0", q=None)
    try_with("reference.q[0]", q=np.zeros((1, 4)))
    try_with("reference.sample", sample=lambda t: (np.zeros(2), np.zeros(2), np.zeros(2)))
    try_with("controller.torque", Constant(np.zeros(2)))
    try_with("controller.torque", Constant(0.0))
    other = ffsms.SpaceManipulator(random_tree(12, 4).model(), "tip")
    refused(
        lambda: simulate(planar, Swing(planar, np.zeros(3)), controller, plant=other),
        InvalidValue,
        "plant",
        "joint_1",
    )
