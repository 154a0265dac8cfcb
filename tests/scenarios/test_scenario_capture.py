"""A client in a scenario file: its tables, and a short run to the end."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scenario_files import CAPTURE as SHORT

from ffsms_pin import scenarios
from ffsms_pin.capture.client_distances import ClientDistances
from ffsms_pin.capture.departure import closest_approach
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.client import AfterCapture
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.opt import Meet, Problem
from ffsms_pin.opt.search import search
from ffsms_pin.scenarios.definition import packaged_path, save_scenario
from ffsms_pin.simulation import Phase, Tracking
from ffsms_pin.simulation.client_motion import client_motion

JOINTS = "joints = [0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9]"

# Most of these tests use the same plan.
pytestmark = pytest.mark.usefixtures("kept_plans")


def _written(folder: Path, text: str) -> scenarios.Scenario:
    path = folder / "short.toml"
    path.write_text(text, encoding="utf-8")
    return scenarios.scenario(path)


def _problem(folder: Path, text: str) -> Problem:
    read = _written(folder, text)
    return read.problem(read.load())


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return scenarios.run(_written(tmp_path_factory.mktemp("short"), SHORT))


def test_the_client_is_caught_and_the_rate_is_as_predicted(outcome: Any) -> None:
    numbers = scenarios.summary(outcome)["capture"]
    assert scenarios.summary(outcome)["tracking"]["note"] == "t = 6 s: latched; t = 10 s: ended"
    assert outcome.trajectory.reached
    assert numbers["contact_velocity_m_per_s"] < 5e-3
    assert numbers["momentum_change_relative"] < 1e-9  # rounding: it differs from processor to processor
    assert [phase["name"] for phase in numbers["phases"]] == [
        "approach",
        "closing",
        "contact",
        "braking",
        "rest",
    ]
    assert numbers["final_joint_rate_max_deg_per_s"] < 1e-3
    assert numbers["caught"]
    assert numbers["predicted_error_deg_per_s"] < 5e-3
    assert numbers["expected_error_deg_per_s"] < 5e-3
    assert 0.0 < numbers["flown_torque_share"] < 1.0
    assert np.linalg.norm(numbers["final_base_rate_deg_per_s"]) > 0.1
    # The recorded momentum of both bodies is constant after the capture.
    drift = np.abs(outcome.capture.tracking.momentum - outcome.capture.after.momentum).max()
    assert drift < 1e-8


def test_the_client_moves_freely_and_then_with_the_arm(outcome: Any, tmp_path: Path) -> None:
    whole = outcome.capture.whole
    assert len(whole.t) == len(outcome.tracking.t) + len(outcome.capture.tracking.t) - 1
    motion = client_motion(whole)
    assert outcome.capture.latched_at == pytest.approx(6.0)
    guarded = replace(outcome.capture, phases=(*outcome.capture.phases, Phase(8.0, "braking", "stopped")))
    assert guarded.latched_at == pytest.approx(6.0)
    free = outcome.capture.client
    for t in (0.0, 2.5, 5.9):
        np.testing.assert_allclose(motion.pose(t).homogeneous, free.pose(t).homogeneous, atol=1e-6)
    # The motion is continuous at the latch; afterwards the pose in the gripper is constant.
    step = motion.pose(6.0).translation - motion.pose(5.996).translation
    assert np.linalg.norm(step) < 1e-3
    rows = np.flatnonzero(whole.t >= 6.0)[[0, 300, -1]]
    relative_poses = [
        outcome.plant.at(whole.q[row]).end_effector_pose.actInv(motion.pose(float(whole.t[row])))
        for row in rows
    ]
    for pose in relative_poses[1:]:
        np.testing.assert_allclose(pose.homogeneous, relative_poses[0].homogeneous, atol=1e-9)
    late = float(whole.t[-1])
    assert np.linalg.norm(motion.pose(late).translation - free.pose(late).translation) > 1e-3

    whole.save(tmp_path / "capture.npz")
    again = client_motion(Tracking.load(tmp_path / "capture.npz"))
    np.testing.assert_array_equal(again.position, motion.position)
    np.testing.assert_array_equal(again.pose(3.0).homogeneous, motion.pose(3.0).homogeneous)


def test_the_scene_shows_the_client(outcome: Any) -> None:
    viewer = pytest.importorskip("ffsms_pin.viewer")
    scene = viewer.view_capture(outcome, fps=2.0)
    assert scene.layers["client"]
    motion = client_motion(outcome.capture.whole)
    times, rows = scene._stage.key_frames._tracks["/ffsms/client", "position", "vector3"]
    assert len(times) > 1
    for t, row in zip(times, rows, strict=True):
        np.testing.assert_allclose(row, motion.pose(t).translation, atol=1e-9)


def test_a_results_folder_shows_the_client(outcome: Any, tmp_path: Path) -> None:
    pytest.importorskip("ffsms_pin.viewer")
    from ffsms_pin.cli.view import scene_of

    outcome.trajectory.save(tmp_path / "trajectory.npz")
    outcome.tracking.save(tmp_path / "tracking.npz")
    outcome.capture.whole.save(tmp_path / "capture.npz")
    save_scenario(outcome.scenario, tmp_path / "scenario.json")
    flown, planned = scene_of(tmp_path, fps=2.0), scene_of(tmp_path, plan_only=True, fps=2.0)
    assert flown.layers["client"]
    assert planned.layers["client"]
    assert (flown.duration, planned.duration) == pytest.approx((10.0, 6.0))
    _, rows = flown._stage.key_frames._tracks["/ffsms/client", "position", "vector3"]
    last = client_motion(outcome.capture.whole).position[-1]
    np.testing.assert_allclose(rows[-1], last, atol=1e-9)
    _, rows = planned._stage.key_frames._tracks["/ffsms/client", "position", "vector3"]
    np.testing.assert_allclose(rows[-1], outcome.capture.client.pose(6.0).translation, atol=1e-9)


def test_a_plan_in_collision_is_not_flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the strategy for limits, a plan to a client out of reach collides with the robot itself."""
    strategies = [strategy for strategy in search.STRATEGIES if strategy.name != "within limits"]
    monkeypatch.setattr(search, "STRATEGIES", strategies)
    text = SHORT.replace(JOINTS, "position = [3.0, 0.5, 0.0]").replace("after = 4.0", "after = 0.5")
    outcome = scenarios.run(_written(tmp_path, text))
    capture = outcome.capture
    assert outcome.trajectory.broken["clearance"] > 0.01
    assert capture is not None
    assert [phase.name for phase in capture.phases] == ["approach", "braking", "rest"]
    assert capture.phases[1].reason.startswith("not flown: in the plan ")
    assert "overlap by" in capture.phases[1].reason
    assert "out of the workspace" in capture.phases[1].reason
    assert not capture.caught
    assert not capture.whole.arrived
    assert capture.whole.misses[0].startswith("the client was not caught (not flown: in the plan ")
    assert np.abs(capture.whole.v[:, 6:]).max() < 1e-9
    assert capture.whole.least_clearance is not None
    assert capture.whole.least_clearance.kept


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "old", "new", "fragment"),
    [
        # A client out of reach; a law that is too weak to follow the plan.
        ("rigid", f"{JOINTS}\n", "position = [3.0, 0.5, 0.0]\n", "missed by 1"),
        (
            "compliant",
            '"computed-torque"\nK_p = 100.0\nK_d = 20.0',
            '"pd"\nK_p = 2.0\nK_d = 2.0',
            "turns relative to the grasp at",
        ),
    ],
)
def test_outside_the_envelope_nothing_is_caught(
    tmp_path: Path, kind: str, old: str, new: str, fragment: str
) -> None:
    assert old in SHORT
    text = SHORT.replace("[contact]\nafter = 4.0", f'[contact]\nkind = "{kind}"\nafter = 0.5')
    text = text.replace("[plan]\n", '[plan]\ncollision = "off"\n') + "[guards]\non = false\n"
    missed = scenarios.run(_written(tmp_path, text.replace(old, new)))
    capture = missed.capture
    assert capture is not None
    assert fragment in capture.missed
    assert ("0.05 m at most" if kind == "rigid" else "0.05 rad/s at most") in capture.missed
    if (
        fragment == "missed by 1"
    ):  # far from the client no retreat is needed, and the reason is that of the plan
        assert [phase.name for phase in capture.phases] == ["approach", "braking", "rest"]
        assert "workspace" in capture.missed
    # Nothing touched the client, and the arm comes to rest with its own momentum.
    assert capture.after is None
    assert not capture.whole.contact_wrench.any()
    assert capture.momentum_error < 1e-6  # at 140 deg/s, with steps of 4 ms
    assert capture.phases[-1].name == "rest"
    motion = client_motion(capture.whole)
    end = float(motion.t[-1])
    np.testing.assert_allclose(motion.pose(end).homogeneous, capture.client.pose(end).homogeneous, atol=1e-9)
    numbers = scenarios.summary(missed)["capture"]
    assert not numbers["caught"]
    assert "predicted_base_rate_deg_per_s" not in numbers


def test_a_miss_is_an_outcome_with_status_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from ffsms_pin.cli import main

    path = tmp_path / "narrow.toml"
    text = SHORT.replace("after = 4.0", "after = 0.5")
    path.write_text(text + "[contact.envelope]\ndistance = 1e-9\n", encoding="utf-8")
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-figures"]) == 1
    printed = capsys.readouterr().out
    assert "not caught" in printed
    assert printed.count("s: approach") == 2  # each phase of two attempts is listed once
    assert len(printed.splitlines()) < 45  # the output fits on one screen
    assert (tmp_path / "out" / "capture.npz").exists()


def test_a_locked_joint_stays_at_rest_when_the_client_is_latched(tmp_path: Path) -> None:
    """A joint that is locked stays at rest in the impact, in the record and in the recorded energies."""
    fault = "[[fault]]\ntime = 5.9\njoint = 1\n[wrist]\nforce_limit = 50.0\n"
    fault += "[contact.envelope]\nspeed = 1.0\nspin = 1.0\n"
    outcome = scenarios.run(_written(tmp_path, SHORT.replace("after = 4.0", "after = 1.0") + fault))
    capture = outcome.capture
    assert capture is not None
    assert capture.after is not None
    row = int(np.searchsorted(capture.whole.t, capture.latched_at - 1e-9))
    np.testing.assert_array_equal(capture.after.v, capture.whole.v[row])
    assert capture.after.v[7] == 0.0
    jump = capture.whole.kinetic_energy[row - 1] - capture.whole.kinetic_energy[row]
    assert capture.after.energy_lost == pytest.approx(jump, rel=0.2)
    # The load of the wrist includes the wrench that carries the client.
    largest = np.linalg.norm(capture.whole.contact_wrench[row:, :3], axis=1).max()
    assert scenarios.summary(outcome)["tracking"]["wrist"]["force_max_N"] == pytest.approx(largest)
    assert largest > 0.1


def test_a_wrong_belief_is_used_for_planning_and_braking(tmp_path: Path) -> None:
    """The plan aims at the first measurement; the model for braking has the believed mass."""
    # A single measurement is too uncertain for the default envelope.
    wide = "[contact.envelope]\ndistance = 0.2\nturn = 0.5\n[contact.go]\ndistance = 0.2\n"
    belief = "[client.sensor]\nseed = 3\n[client.belief]\nmass = 70.0\nmass_deviation = 0.1\n"
    chosen = _written(
        tmp_path, SHORT.replace("[meet]", belief + "[meet]").replace("after = 4.0", "after = 1.0") + wide
    )
    sms = chosen.load()
    goal, true = chosen.problem(sms).goal, chosen.made_client(sms)
    assert isinstance(goal, Meet)
    assert isinstance(goal.client, ClientEstimate)
    assert (goal.client.mass, true.mass) == (70.0, 80.0)
    difference = goal.client.pose(6.0).translation - true.pose(6.0).translation
    outcome = scenarios.run(chosen)
    assert outcome.capture is not None
    # The arm arrives at the planned grasp, beside the true grasp.
    (closing,) = outcome.capture.closings
    assert closing.miss[0] > 0.5 * np.linalg.norm(difference) > 3e-3
    assert outcome.tracking.position_error[-1] == pytest.approx(closing.miss[0], rel=1e-6)
    assert outcome.capture.after is not None
    bare, joined = (pin.computeTotalMass(robot.model) for robot in (sms, outcome.capture.after.robot))
    assert joined - bare == pytest.approx(80.0)
    braking = outcome.capture.braking
    assert braking is not None
    assert pin.computeTotalMass(braking.robot.model) - bare == pytest.approx(70.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[contact]", "[contact.envelope]\nspeed = 0.0\n[contact]", r"\[contact.envelope\] speed"),
        ("[meet]\ngrasp = [0.0, 0.0, -0.4]\nstandoff = 0.05\n", "", r"\[meet\]"),
        ("[plan]", "[target]\nposition = [1.0, 0.0, 0.0]\n[plan]", r"\[target\] is not for a capture"),
        ("size = [0.5", "position = [1.0, 0.0, 0.0]\nsize = [0.5", "both place the client"),
        ("[contact]", "[contact]\nstiffness = 100.0", "compliant"),
        (
            "size = [0.5, 0.6, 0.7]",
            "size = [0.5, 0.6, 0.7]\n[client.belief]\nmass = 70.0",
            r"\[client.sensor\]",
        ),
        ("[plan]", "[reference]\nhold = 1.0\n[plan]", r"\[reference\] hold is not for .*\[contact\] after"),
        ("[plan]\n", "[plan]\nreach = 0.01\n", r"\[plan\] reach is not for .*\[meet\] reach"),
        (
            "[contact]",
            "[contact.go]\nage = 1.0\n[contact]",
            r"\[contact.go\] needs .*\[client.sensor\]",
        ),
        (
            "[contact]",
            "[estimator]\njoint_acceleration = 0.01\n[contact]",
            r"\[estimator\] needs a table \[sensors\]",
        ),
        ("standoff = 0.05", "standoff = 0.0\nhalf_angle_deg = 20.0", r"\[meet\] half_angle"),
        ("[meet]", "[client.sensor]\noutliers = 1.0\n[meet]", r"outliers .*below one"),
        ("[meet]", "[client.sensor]\nhidden = [[1.0]]\n[meet]", r"hidden.* list of 2 numbers"),
        ("[meet]", "[client.sensor]\nhidden = [[2.0, 1.0]]\n[meet]", r"hidden .*a later end"),
        ("inertia = [6.0, 9.0, 11.0]", "inertia = [1.0, 1.0, 11.0]", r"\[client\]"),
    ],
)
def test_inconsistent_tables_are_refused_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in SHORT
    with pytest.raises(InvalidScenario, match=message):
        _problem(tmp_path, SHORT.replace(old, new))


def test_the_packaged_scenario_meets_an_estimate() -> None:
    chosen = scenarios.scenario("capture")
    assert chosen.replans
    sms = chosen.load()
    problem = chosen.problem(sms)
    assert isinstance(problem.goal, Meet)
    assert isinstance(problem.goal.client, ClientEstimate)
    assert problem.momentum is None
    place = problem.goal.place(chosen.arrival)
    joints = chosen.per_joint(sms, "client", "joints")
    assert joints is not None
    assert np.linalg.norm(place.position) < 2.0


@pytest.mark.slow
def test_the_packaged_capture_meets_its_client(tmp_path: Path) -> None:
    """The motion of `ffsms-pin run capture`: noisy and late measurements, a corridor, and re-planning."""
    text = packaged_path("capture").read_text("utf-8").replace("after = 10.0", "after = 0.5")
    outcome = scenarios.run(_written(tmp_path, text))
    assert outcome.note == ""
    assert outcome.capture is not None
    (closing,) = outcome.capture.closings
    assert closing.miss[0] < 2e-3
    assert np.linalg.norm(closing.relative[:3]) < 5e-3


@pytest.mark.slow
@pytest.mark.long
def test_after_a_miss_the_arm_retreats_and_tries_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A push spoils the first attempt; the second one, planned from the retreat, catches the client."""
    push = "".join(
        f"[[disturbance]]\nwrench = [0, {force}, 0, 0, 0, 0]\nstart = {start}\nend = {start + 0.6}\n"
        for start, force in ((4.6, 60.0), (5.2, -60.0))
    )
    text = SHORT.replace("[contact]\nafter = 4.0", "[contact]\nafter = 0.5") + push
    capture = scenarios.run(_written(tmp_path, text)).capture
    assert capture is not None
    names = [phase.name for phase in capture.phases]
    assert names[:4] == ["approach", "closing", "retreat", "approach"]
    assert names[-1] == "rest"
    assert "mm beside its corridor, 50 mm at most" in capture.phases[2].reason
    assert capture.phases[2].time < 6.0  # before the gripper would have closed
    assert capture.caught
    (closing,) = capture.closings
    assert closing.miss[0] < 5e-3
    assert capture.momentum_error < 1e-5  # the momentum balance includes the push
    single = scenarios.run(
        _written(tmp_path, text.replace("after = 0.5", "after = 0.5\nattempts = 1"))
    ).capture
    assert single is not None
    assert not single.caught
    assert "given up after 1 attempt" in single.missed


def test_wheels_hold_the_attitude_before_during_and_after_a_capture(tmp_path: Path) -> None:
    axes = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"
    wheels = f"[wheels]\naxes = {axes}\ninertia = 0.05\nmomentum = 30.0\ntorque = 1.0\n[attitude]\n"
    text = SHORT.replace("dt = 0.02", 'dt = 0.02\nmode = "rotation-floating"')
    text = text.replace("[contact]", f'{wheels}[contact]\nkind = "compliant"')
    capture = scenarios.run(_written(tmp_path, text)).capture
    assert capture is not None
    assert capture.caught
    assert capture.momentum_error < 1e-9
    assert np.abs(capture.whole.wheel_momentum).max() > 0.1
    assert np.degrees(np.linalg.norm(capture.found_rate)) < 0.01  # the same law detumbles the joined bodies
    # The momentum of the wheels and the load of the grip were predicted.
    numbers = capture.numbers()
    final = np.array(numbers["final_wheel_momentum_Nms"])
    for name in ("predicted", "expected"):
        assert np.abs(final - numbers[f"{name}_wheel_momentum_Nms"]).max() < 5e-3 * np.linalg.norm(final)
        assert f"{name}_base_rate_deg_per_s" not in numbers
    assert numbers["expected_contact_force_N"] == pytest.approx(numbers["contact_force_max_N"], rel=0.2)


@pytest.mark.long
@pytest.mark.slow
def test_slow_wheels_take_the_momentum_later(tmp_path: Path) -> None:
    """The prediction is compared with the total momentum, not with that of the wheels so far."""
    axes = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]"
    wheels = f"[wheels]\naxes = {axes}\ninertia = 0.05\nmomentum = 30.0\ntorque = 0.05\n[attitude]\n"
    text = SHORT.replace("dt = 0.02", 'dt = 0.02\nmode = "rotation-floating"')
    text = text.replace("[contact]\nafter = 4.0", f"{wheels}[contact]\nafter = 2.0")
    capture = scenarios.run(_written(tmp_path, text)).capture
    assert capture is not None
    numbers = capture.numbers()
    total, final = (np.array(numbers[f"{name}_wheel_momentum_Nms"]) for name in ("total", "final"))
    np.testing.assert_allclose(total, capture.whole.momentum[-1, 3:], atol=1e-9)
    assert np.linalg.norm(final - total) > 0.2 * np.linalg.norm(total)
    assert numbers["expected_error_Nms"] < 5e-3 * np.linalg.norm(total)


@pytest.mark.slow
@pytest.mark.parametrize("opening", [0.04, pytest.param(0.005, marks=pytest.mark.long)])
def test_an_open_gripper_encloses_a_ring(tmp_path: Path, opening: float) -> None:
    """With a play of 17 mm on either side no pad touches the rim; pads closer than its thickness push it."""
    ring = f"[contact.ring]\nopening = {opening}\nstiffness = 1e5\n"
    text = SHORT.replace("[contact]\nafter = 4.0", '[contact]\nkind = "compliant"\nafter = 0.5')
    capture = scenarios.run(_written(tmp_path, text + ring)).capture
    assert capture is not None
    before = capture.whole.t < capture.contact_at - 1e-9
    largest = np.linalg.norm(capture.whole.contact_wrench[before, :3], axis=1).max()
    if opening > 0.01:
        assert capture.caught, capture.missed
        assert largest < 10.0
        assert capture.momentum_error < 1e-6
    else:
        assert largest > 1.0
    assert len(capture.client.shapes) == 1 + 36  # its body and the ring's pieces
    with pytest.raises(InvalidScenario, match="keep one"):
        _written(tmp_path, text + ring + "[contact.nozzle]\n")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("more", "fragment"),
    [
        pytest.param(
            "[contact.envelope]\nforce = 0.5\ndistance = 1.0\nturn = 1.0\n",
            "the grip may have to bear",
            marks=pytest.mark.long,
        ),
        ("torque_share = 1e-3\n", "of a joint's torque limit"),
    ],
)
def test_an_excessive_load_or_braking_torque_is_no_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: str, fragment: str
) -> None:
    """The hold point is not left, before the gripper closes; without the check the client is caught."""
    monkeypatch.setattr("ffsms_pin.capture.braking._LONGEST", 4.0)  # [s], the longest braking
    sensor = "[client.sensor]\nposition_noise = 1e-4\nvelocity_noise = 2e-4\nrate_noise = 2e-4\n[meet]"
    text = SHORT.replace("[meet]", sensor).replace(
        "[contact]\nafter = 4.0", '[contact]\nkind = "compliant"\nattempts = 1\nafter = 0.5'
    )
    checked = scenarios.run(_written(tmp_path, text + more)).capture
    assert checked is not None
    assert not checked.caught
    assert fragment in checked.missed
    monkeypatch.setattr("ffsms_pin.capture.state_machine.go_no_go", lambda *_: "")
    unguarded = "[guards]\non = false\n"  # guards would stop the flight at the contact
    unchecked = scenarios.run(_written(tmp_path, text + more + unguarded)).capture
    assert unchecked is not None
    assert unchecked.caught


def test_the_load_of_the_wrist_is_reported_beside_its_limits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from ffsms_pin.cli import main

    monkeypatch.setenv("COLUMNS", "160")  # each row in one line
    path = tmp_path / "weak.toml"
    path.write_text(SHORT.replace("after = 4.0", "after = 0.5") + "[wrist]\nmoment_limit = 1e-3\n", "utf-8")
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--no-figures"]) == 1  # a guard trips
    (row,) = (line for line in capsys.readouterr().out.splitlines() if "largest load of the wrist" in line)
    share = float(row.split("│")[3].split("%")[0])
    assert "% of its limits" in row
    assert share > 100.0


def _with_dark_camera(folder: Path, hidden: str, more: str = "") -> scenarios.Scenario:
    """Return the packaged capture with a camera that is hidden for a while, in coarser steps."""
    text = packaged_path("capture").read_text("utf-8").replace("after = 10.0", "after = 1.0")
    text = text.replace("period = 0.1 ", f"hidden = [{hidden}]\nseed = 1\nperiod = 0.1 ")
    text = text.replace('kind = "re-planning"\ndt = 0.02 ', 'kind = "re-planning"\nperiod = 0.5\ndt = 0.05 ')
    text = text.replace("dt = 0.002 ", "dt = 0.004 ") + more
    return _written(folder, text.replace("[contact]\n", "[contact]\nattempts = 1\n"))


@pytest.mark.slow
def test_a_closing_arm_aborts_when_the_camera_is_dark(tmp_path: Path) -> None:
    """The arm retreats without contact, within all limits, to a rest that is clear for ten minutes."""
    outcome = scenarios.run(_with_dark_camera(tmp_path, "[9.0, 11.8]"))
    capture = outcome.capture
    assert capture is not None
    assert not capture.caught
    names = [phase.name for phase in capture.phases]
    assert (names[:3], names[-2:]) == (["approach", "closing", "retreat"], ["braking", "rest"])
    # The last picture was made at 8.9 s; 2 s beyond the latency of 0.2 s are allowed.
    abort = capture.phases[2]
    assert 8.9 + 2.2 < abort.time < 8.9 + 2.2 + 0.5
    assert abort.reason.startswith("the client was last measured 2")
    whole, limits = capture.whole, outcome.sms.limits
    assert not whole.contact_wrench.any()
    assert (np.abs(whole.v[:, 6:]) <= limits.velocity).all()
    assert np.abs(whole.v[-1, 6:]).max() < 1e-3
    assert capture.momentum_error < 1e-6
    assert whole.least_clearance is not None
    assert whole.least_clearance.kept
    numbers = scenarios.summary(outcome)["capture"]
    assert numbers["clear_afterwards"]
    assert numbers["keep_clear_s"] == 600.0
    # The bodies' free motions from the end of the recording are clear.
    assert capture.departure is not None
    end, client = float(whole.t[-1]), capture.client
    rest = AfterCapture(
        outcome.sms, whole.q[-1], whole.v[-1], outcome.sms.at(whole.q[-1], whole.v[-1]).momentum, 0.0
    )
    shapes = [obstacle for obstacle in outcome.scenario.obstacles(client) if obstacle.moves]
    distances = ClientDistances(outcome.sms, shapes, 0.01, "auto")
    assert closest_approach(distances, rest, client, end, 600.0).distance > 0.0


@pytest.mark.long
@pytest.mark.slow
def test_a_dark_camera_is_no_go(tmp_path: Path) -> None:
    capture = scenarios.run(_with_dark_camera(tmp_path, "[6.0, 11.8]")).capture
    assert capture is not None
    assert "closing" not in [phase.name for phase in capture.phases]
    assert capture.phases[1].reason.startswith("no go: the client was last measured ")
    assert not capture.whole.contact_wrench.any()
    assert "array" not in capture.missed


@pytest.mark.long
@pytest.mark.slow
def test_the_largest_age_of_measurements_is_an_option(tmp_path: Path) -> None:
    capture = scenarios.run(_with_dark_camera(tmp_path, "[8.0, 10.2]", "[contact.go]\nage = 3.0\n")).capture
    assert capture is not None
    assert capture.caught, capture.missed
