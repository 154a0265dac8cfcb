"""Paths: tracking within tolerance at every instant, checked by a finer rollout with Pinocchio."""

from __future__ import annotations

import re
from pathlib import Path as File
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from rolled import rolled_out_by_pinocchio

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.capture import Camera, ClientEstimate
from ffsms_pin.errors import InvalidValue
from ffsms_pin.export import to_csv

PERIOD = 6.0  # [s]


@pytest.fixture(scope="module")
def q0(planar: Any) -> Any:
    return planar.configuration([0.3, 0.6, 0.5])


def circle(pose: Any, radius: float = 0.05, x: Any = (1.0, 0.0, 0.0), y: Any = (0.0, 1.0, 0.0)) -> Any:
    """Return a circle through a pose, once in `PERIOD`, as a function of time."""

    def place(t: float) -> Any:
        a = 2.0 * np.pi * t / PERIOD
        return pose.translation + radius * ((np.cos(a) - 1.0) * np.array(x) + np.sin(a) * np.array(y))

    return place


def errors(sms: Any, plan: opt.Trajectory, curve: Any, approach: float) -> Any:
    """Return the largest distance and angle from a curve of positions or poses after the approach."""
    times, poses = rolled_out_by_pinocchio(sms, plan)
    deviations = []
    for t, pose in zip(times, poses, strict=True):
        if t < approach:
            continue
        target = curve(t - approach)
        has_attitude = isinstance(target, pin.SE3)
        angle = np.linalg.norm(pin.log3(target.rotation.T @ pose.rotation)) if has_attitude else 0.0
        place = target.translation if has_attitude else target
        deviations.append((float(np.linalg.norm(pose.translation - place)), float(angle)))
    return np.max(deviations, axis=0)


def test_circle_of_positions(planar: Any, q0: Any) -> None:
    """Check the tracking error of a function of time by an independent, finer rollout."""
    curve = circle(planar.at(q0).end_effector_pose)
    plan = opt.plan(planar, q0, opt.Path(curve, approach_time=2.0), duration=2.0 + PERIOD)
    assert plan.reached, plan.note
    assert plan.within_tolerance
    assert plan.note == ""
    assert plan.path_error.shape == plan.path_angle_error.shape == plan.t.shape
    distance, _ = errors(planar, plan, curve, 2.0)
    assert distance < 1e-5
    assert plan.path_error.max() == pytest.approx(distance, abs=2e-6)


def test_poses_and_a_free_axis(panda: Any, bent: Any) -> None:
    """A path that leaves the turn about the tool's axis free costs less."""
    pose = panda.at(bent).end_effector_pose
    R = pose.rotation
    line = circle(pose, 0.08, R[:, 0], R[:, 1])
    curve = lambda t: pin.SE3(R, line(t))  # noqa: E731
    held = opt.plan(panda, bent, opt.Path(curve, approach_time=2.0), duration=2.0 + PERIOD)
    free = opt.plan(
        panda, bent, opt.Path(curve, approach_time=2.0, free_axis=[0, 0, 2]), duration=2.0 + PERIOD
    )
    assert held.reached, held.note
    assert free.reached, free.note
    distance, angle = errors(panda, held, curve, 2.0)
    assert distance < 1e-5
    assert angle < 1e-5
    times, poses = rolled_out_by_pinocchio(panda, free)
    axes = np.array([place.rotation[:, 2] for t, place in zip(times, poses, strict=True) if t >= 2.0])
    assert np.arccos(np.clip(axes @ R[:, 2], -1.0, 1.0)).max() < 2e-4
    assert errors(panda, free, curve, 2.0)[1] > 0.02  # it turned about the free axis
    assert sum(free.shares.values()) < 0.9 * sum(held.shares.values())


def test_a_path_on_the_base(planar: Any, q0: Any) -> None:
    """A path in base axes moves with the base, which the arm turns."""
    base = pin.XYZQUATToSE3(q0[:7])
    here = base.actInv(planar.at(q0).end_effector_pose)
    curve = circle(here)
    plan = opt.plan(planar, q0, opt.Path(curve, frame="base", approach_time=2.0), duration=2.0 + PERIOD)
    assert plan.reached, plan.note
    assert plan.base_rotation.max() > 1e-3
    for k in range(200, len(plan.t), 25):
        root = pin.XYZQUATToSE3(plan.q[k, :7])
        assert np.allclose(root.actInv(plan.end_effector[k]), curve(plan.t[k] - 2.0), atol=1e-5)


def test_a_path_on_a_tumbling_client(panda: Any, bent: Any) -> None:
    """A path in a client's axes moves and turns with it."""
    pose = panda.at(bent).end_effector_pose
    twist = [0.002, 0.0, 0.0, 0.01, 0.02, -0.01]
    place = pin.SE3(np.eye(3), pose.translation + np.array([0.4, 0.0, 0.0]))
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose=place, twist=twist)
    in_client = place.actInv(pose)
    curve = circle(in_client, 0.05)
    plan = opt.plan(panda, bent, opt.Path(curve, frame=client, approach_time=2.0), duration=2.0 + PERIOD)
    assert plan.reached, plan.note

    def moved(t: float) -> Any:
        return client.pose(t + 2.0).act(curve(t))

    assert errors(panda, plan, moved, 2.0)[0] < 1e-5
    assert np.linalg.norm(moved(PERIOD) - moved(0.0)) > 5e-3  # the client has carried it away


def test_path_on_an_estimate_moves_with_it() -> None:
    """A path that was evaluated before a measurement is evaluated anew after it."""
    place = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    shifted = pin.SE3(np.eye(3), np.array([1.001, 0.0, 0.0]))
    first, second = (ffsms.Client(80.0, [6.0, 9.0, 11.0], pose=pose) for pose in (place, shifted))
    estimate, times = ClientEstimate(first, 0.0, Camera()), np.linspace(0.0, 5.0, 6)
    path = opt.Path([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], times=[0.0, 5.0], frame=estimate)
    before = path.points(times).positions
    assert estimate.observe(second, 0.5)
    moved = path.points(times).positions - before
    assert moved[0, 0] == pytest.approx(estimate.pose(0.0).translation[0] - 1.0, abs=1e-12)
    assert moved[0, 0] > 1e-4


def test_samples_with_times(planar: Any, q0: Any) -> None:
    """Cubic splines join the samples."""
    curve = circle(planar.at(q0).end_effector_pose)
    times = np.linspace(0.0, PERIOD, 61)
    samples = [curve(t) for t in times]
    plan = opt.plan(planar, q0, opt.Path(samples, times=times, approach_time=2.0), duration=2.0 + PERIOD)
    assert plan.reached, plan.note
    assert errors(planar, plan, curve, 2.0)[0] < 1e-4
    for method in ("horizon", "resolved-rate"):
        part = opt.plan(
            planar, q0, opt.Path(samples, times=times, approach_time=2.0), duration=PERIOD, method=method
        )
        assert part.reached, part.note
        assert "the motion ends 2 s before the last sample of the path" in part.note
    late = opt.Path(samples, times=times)
    with pytest.raises(InvalidValue, match=r"times must reach the end of the motion.*6 s"):
        opt.plan(planar, q0, late, duration=9.0)


@pytest.mark.parametrize("as_samples", [False, True])
def test_geometric_curves_get_an_even_speed(planar: Any, q0: Any, as_samples: bool) -> None:
    """The duration is the problem's; the speed is constant except at its smooth ends."""
    curve = circle(planar.at(q0).end_effector_pose)
    if as_samples:
        path = opt.Path([curve(t) for t in np.linspace(0.0, PERIOD, 61)])
    else:  # a parameter that runs unevenly along the curve
        path = opt.Path(lambda x: curve(PERIOD * x**2), parameter=(0.0, 1.0))
    plan = opt.plan(planar, q0, path, duration=10.0)
    assert plan.reached, plan.note
    steps = np.linalg.norm(np.diff(plan.end_effector, axis=0), axis=1) / plan.dt
    even = steps[200:-200]
    assert np.ptp(even) < 2e-3 * even.mean()
    assert even.mean() == pytest.approx(2.0 * np.pi * 0.05 / 8.5, rel=5e-3)
    assert steps[[0, -1]].max() < 1e-3 * even.mean()


def test_start_beside_the_path(planar: Any, q0: Any) -> None:
    """Without an approach the error gives the distance; with an approach the arm comes to the path."""
    pose = planar.at(q0).end_effector_pose
    away = circle(pin.SE3(np.eye(3), pose.translation - [0.1, 0.0, 0.0]))
    with pytest.raises(
        InvalidValue, match=r"approach_time .* begins 100 mm from the end effector; .*approach_time="
    ):
        opt.plan(planar, q0, opt.Path(away), duration=PERIOD)
    plan = opt.plan(planar, q0, opt.Path(away, approach_time=3.0), duration=3.0 + PERIOD)
    assert plan.reached, plan.note
    assert errors(planar, plan, away, 3.0)[0] < 1e-5


def test_path_that_begins_with_a_velocity(planar: Any, q0: Any) -> None:
    """An arm at rest cannot follow; the note says so and proposes an approach."""
    curve = circle(planar.at(q0).end_effector_pose)
    plan = opt.plan(planar, q0, opt.Path(curve), duration=PERIOD)
    assert not plan.reached
    assert plan.path_error.max() > 1e-3
    assert "differs by 52.4 mm/s" in plan.note
    assert "approach_time=" in plan.note


def test_a_path_too_fast_for_the_joints(planar: Any, q0: Any) -> None:
    """The note names the limit, the time on the path and a sufficient duration, in which a plan succeeds."""
    curve = circle(planar.at(q0).end_effector_pose)

    def path(duration: float) -> opt.Path:
        return opt.Path(lambda x: curve(PERIOD * x), parameter=(0.0, 1.0))

    plan = opt.plan(planar, q0, path(2.0), duration=2.0)
    assert not plan.reached
    assert "path" in plan.broken
    assert re.search(
        r"leaves the path at [\d.]+ s, \d+ % of the path's time; binding: the acceleration limit", plan.note
    )
    assert 2.0 < plan.shortest_duration < 8.0
    assert f"{plan.shortest_duration:.2f} s would suffice" in plan.note
    slower = opt.plan(planar, q0, path(plan.shortest_duration), duration=plan.shortest_duration)
    assert slower.reached, slower.note
    quicker = opt.plan(planar, q0, path(0.0), duration=0.75 * plan.shortest_duration)
    assert not quicker.reached


def test_a_path_out_of_reach(planar: Any, q0: Any) -> None:
    """The note names the workspace as the limit."""
    begin = planar.at(q0).end_effector_pose.translation
    plan = opt.plan(planar, q0, opt.Path([begin, begin + np.array([0.6, 0.6, 0.0])]), duration=20.0)
    assert not plan.reached
    assert "binding: the workspace, because the path is" in plan.note
    assert plan.shortest_duration == 0.0


def test_the_descent_uses_redundancy_to_lower_the_terms(panda: Any, bent: Any) -> None:
    """The descent lowers the base-turn cost of the same path by at least a fifth."""
    pose = panda.at(bent).end_effector_pose
    path = opt.Path(circle(pose, 0.1, pose.rotation[:, 0], pose.rotation[:, 1]), approach_time=2.0)
    terms = [opt.Smooth(), opt.Effort(), opt.BaseTurn(1.0)]
    problem = opt.Problem(panda, bent, path, 2.0 + PERIOD, terms=terms)
    rollout_only = opt.solve(problem, opt.SearchOptions(without=("descent",)))
    plan = opt.solve(problem)
    assert rollout_only.reached
    assert plan.reached
    assert plan.shares["base turn"] < 0.8 * rollout_only.shares["base turn"]
    assert plan.path_error.max() < 1e-5


def test_single_step_methods_follow_a_path(panda: Any, bent: Any) -> None:
    """Each method weights redundant motion differently."""
    pose = panda.at(bent).end_effector_pose
    path = opt.Path(circle(pose, 0.05, pose.rotation[:, 0], pose.rotation[:, 1]), approach_time=2.0)
    turns = {}
    for method in ("resolved-rate", "step", "least-disturbance", "minimum-effort"):
        plan = opt.plan(panda, bent, path, duration=2.0 + PERIOD, dt=0.02, method=method)
        assert plan.reached, plan.note
        assert plan.path_error.max() < 1e-5
        turns[method] = plan.base_rotation.max()
    assert turns["least-disturbance"] < 0.3 * turns["resolved-rate"]
    assert turns["step"] == turns["resolved-rate"]
    with pytest.raises(InvalidValue, match="does not support moving goals"):
        opt.plan(panda, bent, path, duration=2.0 + PERIOD, method="paper")


@pytest.mark.parametrize(
    "options",
    [
        {"momentum": [0.2, 0.0, 0.1, 0.1, 0.3, -0.2]},
        {"mode": "rotation-flying"},
        {"locked": ["panda_joint3"]},
    ],
)
def test_momentum_held_bases_and_locked_joints(panda: Any, bent: Any, options: dict[str, Any]) -> None:
    """Check positions at every 20th node by Pinocchio."""
    pose = panda.at(bent).end_effector_pose
    curve = circle(pose, 0.05, pose.rotation[:, 0], pose.rotation[:, 1])
    path = opt.Path(curve, approach_time=2.0)
    plan = opt.plan(panda, bent, path, duration=2.0 + PERIOD, dt=0.02, **options)
    assert plan.reached, plan.note
    for k in range(100, len(plan.t), 20):
        place = panda.at(plan.q[k]).end_effector_pose.translation
        assert np.linalg.norm(place - curve(plan.t[k] - 2.0)) < 1e-4
    if "momentum" in options:
        momentum = panda.at(plan.q[250], plan.v[250]).momentum
        assert momentum == pytest.approx(np.array(options["momentum"]), abs=1e-10)
        assert plan.base_rotation.max() > 0.05
    if "mode" in options:
        assert plan.base_rotation.max() < 1e-9
    if "locked" in options:
        assert np.abs(plan.joint_rates[:, 2]).max() == 0.0


def test_files_keep_the_errors(planar: Any, q0: Any, tmp_path: File) -> None:
    """Check an npz file and a CSV file."""
    curve = circle(planar.at(q0).end_effector_pose)
    plan = opt.plan(planar, q0, opt.Path(curve, approach_time=2.0), duration=2.0 + PERIOD)
    plan.save(tmp_path / "plan.npz")
    loaded = opt.Trajectory.load(tmp_path / "plan.npz")
    assert np.array_equal(loaded.path_error, plan.path_error)
    assert np.array_equal(loaded.path_angle_error, plan.path_angle_error)
    to_csv(planar, plan, tmp_path / "plan.csv")
    head = (tmp_path / "plan.csv").read_text().splitlines()[0]
    assert "path error [m]" in head.split(",")
    still = opt.plan(planar, q0, planar.at(q0).end_effector_pose.translation, duration=1.0)
    assert np.isnan(still.path_error).all()


def test_a_flight_that_leaves_its_path_has_not_arrived(planar: Any, q0: Any) -> None:
    """The judged motion ends at the path's last point."""
    curve = circle(planar.at(q0).end_effector_pose)
    plan = opt.plan(planar, q0, opt.Path(curve, approach_time=2.0), duration=2.0 + PERIOD)
    controller = ffsms.ComputedTorque(planar)
    good = ffsms.simulate(planar, plan, controller, dt=2e-3)
    assert good.arrived, good.note
    assert good.position_error.max() < 1e-3
    straight = opt.plan(planar, q0, plan.end_effector[-1], duration=2.0 + PERIOD)
    assert plan.problem is not None
    verdict = opt.flown.judge(plan.problem, planar, straight.t, straight.q, straight.v)
    assert not verdict.arrived
    assert any("off its path" in miss for miss in verdict.misses)


HERE = np.array([0.5, 0.0, 0.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"curve": []}, "curve must have at least two samples"),
        ({"curve": 3.0}, "curve must be a function, or samples"),
        ({"curve": [HERE, HERE + 1.0], "times": [0.0, 0.0]}, r"times must increase, but times\[1\]"),
        ({"curve": [HERE, HERE + 1.0], "times": [1.0, 2.0]}, "times must begin at zero"),
        ({"curve": [HERE, HERE + 1.0], "times": [0.0]}, "times must have shape"),
        ({"curve": [HERE, [np.nan, 0.0, 0.0]]}, "curve must be finite"),
        ({"curve": [HERE, HERE, HERE + 1.0]}, r"curve must not repeat a sample; remove curve\[1\]"),
        ({"curve": lambda t: [1.0, 2.0]}, r"curve\(0\) must be a position \(3,\)"),
        ({"curve": lambda t: [np.nan, 2.0, 0.0]}, r"curve\(0\) must be finite"),
        (
            {"curve": lambda t: HERE, "times": [0.0, 1.0]},
            "times must be left out unless the curve is samples",
        ),
        ({"curve": lambda t: HERE, "parameter": (1.0, 1.0)}, "parameter must be two different values"),
        ({"curve": lambda t: HERE, "parameter": (0.0, 1.0)}, "curve must have a length"),
        (
            {"curve": [HERE, HERE + 1.0], "parameter": (0.0, 1.0)},
            "parameter must be left out if the curve is samples",
        ),
        (
            {"curve": lambda t: HERE, "free_axis": [0, 0, 1]},
            "free_axis must be left out of a path of positions",
        ),
        ({"curve": lambda t: HERE, "timing": "slowest"}, 'timing must be "given"'),
        ({"curve": lambda t: HERE, "tolerance": 0.0}, "tolerance must be"),
        ({"curve": lambda t: HERE, "orientation_tolerance": -1.0}, "orientation_tolerance must be"),
        ({"curve": lambda t: HERE, "approach_time": -1.0}, "approach_time must be at least zero"),
        ({"curve": lambda t: HERE, "frame": "client"}, "frame must be"),
    ],
)
def test_wrong_paths(arguments: dict[str, Any], message: str) -> None:
    """The message names the argument, the value and what is allowed."""
    with pytest.raises(InvalidValue, match=message):
        opt.Path(**arguments)


def test_jumps_and_wrong_values_along_the_path(planar: Any, q0: Any) -> None:
    """Making a problem checks the whole curve, not only its start."""
    begin = planar.at(q0).end_effector_pose.translation
    with pytest.raises(InvalidValue, match=r"must be continuous, but it jumps near 3.* s"):
        opt.plan(
            planar, q0, opt.Path(lambda t: begin + np.array([0.0, 0.05 * (t > 3.0), 0.0])), duration=PERIOD
        )
    jumping = opt.Path(lambda x: begin + np.array([-0.1 * x, 0.05 * (x > 0.5), 0.0]), parameter=(0.0, 1.0))
    with pytest.raises(InvalidValue, match=r"jumps near 0\.\d+ of its length"):
        opt.plan(planar, q0, jumping, duration=PERIOD)
    with pytest.raises(InvalidValue, match=r"curve\(.*\) must be finite"):
        opt.plan(planar, q0, opt.Path(lambda t: begin * (1.0 if t < 2.0 else np.nan)), duration=PERIOD)
    with pytest.raises(InvalidValue, match="approach_time must be shorter than the motion, which lasts 6 s"):
        opt.plan(planar, q0, opt.Path(lambda t: begin, approach_time=7.0), duration=PERIOD)


@pytest.mark.parametrize("option", [{"without": ["step rollouts"]}, {"cost_tolerance": 0.1}])
def test_options_of_searches_are_refused(planar: Any, q0: Any, option: dict[str, Any]) -> None:
    """A path needs no search; the error names the option that would be ignored."""
    curve = circle(planar.at(q0).end_effector_pose)
    problem = opt.Problem(planar, q0, opt.Path(curve, approach_time=2.0), 2.0 + PERIOD)
    with pytest.raises(InvalidValue, match=f"{next(iter(option))} .* for an opt.Path"):
        opt.solve(problem, opt.SearchOptions(**option))
