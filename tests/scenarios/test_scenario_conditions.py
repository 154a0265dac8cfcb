"""The closed loop of a scenario file under real conditions equals `simulate` with the same arguments."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from condition_files import CONDITIONS, QUICK, run_text, text

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation as sim
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.options.tables import options_of
from ffsms_pin.scenarios import Outcome, run, scenario, summary


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return run_text(tmp_path_factory.mktemp("plain"), QUICK)


def test_a_file_with_every_condition_equals_simulate_with_every_keyword(
    tmp_path: Path, planar: ffsms.SpaceManipulator
) -> None:
    outcome = run_text(
        tmp_path,
        text(*CONDITIONS)
        + "[estimator]\njoint_acceleration = 0.01\nbase_acceleration = 1e-3\n"
        + '[[disturbance]]\nwrench = [0.01, 0, 0, 0, 0, 0]\non = "end-effector"\nend = inf\n'
        + "[guards]\nposition_margin_deg = 90.0\nrate_margin = inf\njoint_error = 2.0\nfailed_steps = 4\n"
        + "saturation = inf\ncontact_force = 30.0\ncontact_torque = 3.0\ncontact_share = 0.5\n"
        + "base_rate_deg = 90.0\nenergy = inf\n",
    )
    q0 = planar.configuration(np.radians([23.0, 40.0, -29.0]))
    plan = opt.plan(planar, q0, [0.75, 0.5, 0.0], duration=2.0, dt=0.05, method="resolved-rate")
    by_hand = sim.simulate(
        planar,
        plan,
        control.ComputedTorque(planar),
        dt=0.01,
        plant=sim.perturb(
            planar,
            arm_mass=[1.2, 1.1, 0.9],
            arm_inertia=1.3,
            arm_com=[0.01, 0.0, 0.0],
            base_mass=0.9,
            base_inertia=0.95,
            base_com=[0.0, 0.01, 0.0],
        ),
        conditions=sim.Conditions(
            momentum=[0.01, -0.02, 0.0, 0.0, 0.0, 0.003],
            integrator="variational",
            friction=sim.JointFriction(0.02, [0.001, 0.002, 0.003], np.radians(2.0)),
            actuator=sim.Actuator(0.05, [2.0, 3.0, np.inf], 0.03),
            sensors=sim.Sensors(
                joint_resolution=float(np.radians(0.1)),
                joint_noise=1e-4,
                joint_rate_noise=1e-3,
                base_position_noise=1e-3,
                base_attitude_noise=float(np.radians(0.05)),
                base_velocity_noise=1e-3,
                base_rate_noise=1e-3,
                base_latency=0.05,
                seed=7,
            ),
            estimator=sim.Estimator(joint_acceleration=0.01, base_acceleration=1e-3),
            disturbances=[
                sim.Wrench([0.0, 0.0, 0.0, 0.0, 0.0, 0.01], "base", 0.5, 1.0),
                sim.Wrench([0.01, 0.0, 0.0, 0.0, 0.0, 0.0], "end-effector"),
            ],
            events=[
                sim.Capture(1.0, 0.5, [0.01, 0.01, 0.01], [0.05, 0.0, 0.0], [0.01, 0.0, 0.0, 0.0, 0.0, 0.02]),
                sim.JointFault(1.5, "joint_2", "limp", reported=False),
            ],
            guards=sim.Guards(
                position_margin=float(np.radians(90.0)),
                rate_margin=np.inf,
                saturation=np.inf,
                joint_error=2.0,
                contact_force=30.0,
                contact_torque=3.0,
                contact_share=0.5,
                base_rate=float(np.radians(90.0)),
                energy=np.inf,
                failed_steps=4,
            ),
        ),
    )
    np.testing.assert_array_equal(outcome.tracking.q, by_hand.q)
    np.testing.assert_array_equal(outcome.tracking.tau, by_hand.tau)
    assert outcome.tracking.note == by_hand.note
    assert "captured 0.5 kg" in by_hand.note
    conditions = summary(outcome)["conditions"]
    assert set(conditions) >= {*CONDITIONS, "estimator", "control", "reference", "guards"} - {"disturbance"}
    assert "disturbance 2" in conditions


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition_changes_the_motion_and_not_the_plan(
    tmp_path: Path, plain: Outcome, name: str
) -> None:
    outcome = run_text(tmp_path, text(name))
    np.testing.assert_array_equal(
        outcome.trajectory.q, plain.trajectory.q
    )  # the plan does not use the condition
    assert np.abs(outcome.tracking.q[-1] - plain.tracking.q[-1]).max() > 1e-7


@pytest.mark.parametrize("law", control.LAWS)
def test_a_law_by_name_with_its_gains(tmp_path: Path, law: str, planar: ffsms.SpaceManipulator) -> None:
    values: dict[str, Any] = {gain: 0.5 + 0.25 * i for i, gain in enumerate(options_of(control.LAWS[law]))}
    values |= {"adaptive": False} if law == "computed-torque" else {}
    lines = "".join(f"{gain} = {json.dumps(value)}\n" for gain, value in values.items())
    outcome = run_text(
        tmp_path, QUICK.replace('law = "computed-torque"\n', f'law = "{law}"\n{lines}') + "[wrist]\n"
    )
    assert type(outcome.controller) is control.LAWS[law]
    expected = control.LAWS[law](planar, **values)
    for gain in values:
        np.testing.assert_array_equal(getattr(outcome.controller, gain), getattr(expected, gain))
    by_hand = sim.simulate(
        planar, outcome.trajectory, expected, dt=0.01, conditions=sim.Conditions(wrist=sim.WristSensor())
    )
    np.testing.assert_array_equal(outcome.tracking.tau, by_hand.tau)


def test_loads_of_wrist_and_joints_are_reported_beside_their_limits(tmp_path: Path) -> None:
    push = '[[disturbance]]\non = "end-effector"\nwrench = [0.03, 0.04, 0, 0, 0, 0.02]\nend = 1.0\n'
    law = 'law = "admittance"\nstiffness = 20.0\nturn_stiffness = 1.0'
    text = (
        QUICK.replace('law = "computed-torque"', law)
        + "[wrist]\nbias = [1, 1, 1, 1, 1, 1]\nforce_limit = 0.5\n"
    )
    outcome = run_text(tmp_path, text + push)
    numbers = summary(outcome)["tracking"]
    true = {
        "force_max_N": pytest.approx(0.05),
        "moment_max_Nm": pytest.approx(0.02),
    }  # without the bias of the sensor
    assert numbers["wrist"] == {**true, "force_limit_N": 0.5, "moment_limit_Nm": None}
    share = np.abs(outcome.tracking.tau / outcome.controller.torque_limit).max()
    assert numbers["torque_max_relative"] == pytest.approx(share)
    assert summary(outcome)["conditions"]["wrist"].endswith("force_limit 0.5")
    assert "wrist" not in summary(run_text(tmp_path, QUICK))["tracking"]


def test_random_plants_are_those_of_their_seed(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    outcome = run_text(
        tmp_path, QUICK + "[plant]\nbase_mass = 1.1\n[plant.random]\nseed = 3\narm_mass = 0.5\n"
    )
    start = sim.perturb(planar, base_mass=1.1)
    (drawn,) = sim.random_plants(start, np.random.default_rng(3), 1, arm_mass=0.5)
    expected = [float(body.mass) for body in drawn.model.inertias]
    assert [float(body.mass) for body in outcome.plant.model.inertias] == expected
    other = run_text(tmp_path, QUICK + "[plant]\nbase_mass = 1.1\n[plant.random]\nseed = 4\narm_mass = 0.5\n")
    assert [float(body.mass) for body in other.plant.model.inertias] != expected


def test_a_plant_from_another_file(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    from ffsms_pin.urdf import model_path

    urdf = Path(model_path("planar_3r")).read_text(encoding="utf-8")
    mass = re.search(r'<mass value="(31[^"]*)"', urdf)
    assert mass is not None
    (tmp_path / "light.urdf").write_text(urdf.replace(mass.group(0), '<mass value="20.0"'), encoding="utf-8")
    outcome = run_text(tmp_path, QUICK + '[plant]\nmodel = "light.urdf"\narm_mass = 1.1\n')
    masses = [float(body.mass) for body in outcome.plant.model.inertias]
    model = [float(body.mass) for body in planar.model.inertias]
    assert masses[1] == 20.0
    np.testing.assert_allclose(masses[2:], 1.1 * np.array(model[2:]))


def test_a_plant_from_another_file_has_the_locked_joints_and_wheels_of_the_robot(tmp_path: Path) -> None:
    from ffsms_pin.urdf import model_path

    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    wheel = f'<link name="wheel">{body}</link><joint name="spin" type="continuous"><parent link="base"/>'
    wheel += '<child link="wheel"/><axis xyz="0 0 1"/><limit effort="1" velocity="9"/></joint></robot>'
    urdf = Path(model_path("planar_3r")).read_text(encoding="utf-8").replace("</robot>", wheel)
    (tmp_path / "wheeled.urdf").write_text(urdf, encoding="utf-8")
    options = 'model = "wheeled.urdf"\nwheels = ["spin"]\nlocked_deg = { joint_3 = 20.0 }'
    options += '\nend_effector = "end_effector"'
    text = QUICK.replace('model = "planar_3r"', options).replace("23.0, 40.0, -29.0", "23.0, 40.0")
    (tmp_path / "mine.toml").write_text(text + '[plant]\nmodel = "wheeled.urdf"\n', encoding="utf-8")
    mine = scenario(tmp_path / "mine.toml")
    sms = mine.load()
    plant = mine.load_plant(sms)
    assert plant.joint_names == sms.joint_names == ["joint_1", "joint_2"]
    assert plant.wheels is not None
    assert plant.wheels.names == ("spin",)


def test_the_start_may_be_any_state(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.41, 0.69, -0.5])
    q0[:2] += [0.02, -0.01]
    v0 = np.array([0.001, 0.0, 0.0, 0.0, 0.0, 0.002, 0.01, 0.0, -0.01])
    outcome = run_text(tmp_path, QUICK + f"[simulation]\nq0 = {q0.tolist()}\nv0 = {v0.tolist()}\n")
    np.testing.assert_array_equal(outcome.tracking.q[0], q0)
    np.testing.assert_array_equal(outcome.tracking.v[0], v0)


def test_guards_stop_the_flight_and_save_beside_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(QUICK + "[plant]\narm_mass = 3.0\n[guards]\njoint_error = 1e-6\npath = 'stopped.npz'\n")
    outcome = run(scenario(path))
    tracking = outcome.tracking
    assert "off its reference" in tracking.stopped
    assert not tracking.arrived
    assert "stopped.npz" in tracking.note
    np.testing.assert_array_equal(sim.Tracking.load(tmp_path / "stopped.npz").q, tracking.q)
    numbers = summary(outcome)["tracking"]
    assert numbers["stopped"] == tracking.stopped
    assert numbers["misses"][0] == tracking.stopped
    # The former name of the table, and no guards at all.
    path.write_text(QUICK + "[plant]\narm_mass = 3.0\n[watchdog]\njoint_error = 1e-6\n")
    assert run(scenario(path)).tracking.stopped == tracking.stopped
    path.write_text(QUICK + "[plant]\narm_mass = 3.0\n[guards]\njoint_error = 1e-6\non = false\n")
    assert run(scenario(path)).tracking.stopped == ""
    path.write_text(QUICK + "[guards]\n[watchdog]\n")
    with pytest.raises(InvalidScenario, match=r"unknown table \[watchdog\]"):
        scenario(path)


@pytest.mark.long
@pytest.mark.slow
def test_substeps_refine_the_integration(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    """With friction that is steep for the control step, four substeps come closer to sixteen than one."""
    content = QUICK + "[friction]\nviscous = 0.3\n"
    runs = [
        run_text(tmp_path, content + f"[simulation]\nintegrator = 'variational'\nsubsteps = {k}\n").tracking
        for k in (1, 4, 16)
    ]
    coarse, finer = (np.abs(tracking.q - runs[2].q).max() for tracking in runs[:2])
    assert 0.0 < finer < 0.2 * coarse
