"""The closed loop of a scenario file under real conditions: the file says what `simulate` is told."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import IN_DEGREES

import ffsms_pin as ffsms
from ffsms_pin import control, opt
from ffsms_pin import simulation as sim
from ffsms_pin.errors import FfsmsError, InvalidScenario, SimulationStopped
from ffsms_pin.scenarios import Outcome, run, scenario, summary
from ffsms_pin.scenarios.tables import TABLES, gains_of

QUICK = f"""{IN_DEGREES}\
[plan]
duration = 2.0
dt = 0.05
method = "resolved-rate"
[control]
law = "computed-torque"
dt = 0.01
"""

# Every table that only the closed loop knows, each key with a value that is not its default.
CONDITIONS = {
    "simulation": 'integrator = "variational"\nmomentum = [0.01, -0.02, 0, 0, 0, 0.003]\n',
    "plant": "arm_mass = [1.2, 1.1, 0.9]\narm_inertia = 1.3\narm_com = [0.01, 0.0, 0.0]\n"
    "base_mass = 0.9\nbase_inertia = 0.95\nbase_com = [0.0, 0.01, 0.0]\n",
    "friction": "viscous = 0.02\ncoulomb = [0.001, 0.002, 0.003]\ntransition_deg = 2.0\n",
    "actuator": "torque_limit = 0.05\nrate_limit = [2.0, 3.0, inf]\ndelay = 0.03\n",
    "sensors": "joint_resolution_deg = 0.1\njoint_noise = 1e-4\njoint_rate_noise = 1e-3\n"
    "base_position_noise = 1e-3\nbase_attitude_noise_deg = 0.05\nbase_velocity_noise = 1e-3\n"
    "base_rate_noise = 1e-3\nbase_latency = 0.05\nseed = 7\n",
    "disturbance": 'wrench = [0, 0, 0, 0, 0, 0.01]\non = "base"\nstart = 0.5\nend = 1.0\n',
    "capture": "time = 1.0\nmass = 0.5\ninertia = [0.01, 0.01, 0.01]\ncom = [0.05, 0, 0]\n"
    "twist = [0.01, 0, 0, 0, 0, 0.02]\n",
    "fault": 'time = 1.5\njoint = "joint_2"\nkind = "limp"\ntold = false\n',
}


def text(*names: str) -> str:
    """QUICK with some of the conditions."""
    several = ("disturbance", "capture", "fault")
    return QUICK + "".join(
        (f"[[{name}]]\n" if name in several else f"[{name}]\n") + CONDITIONS[name] for name in names
    )


def ran(folder: Path, content: str) -> Outcome:
    path = folder / "mine.toml"
    path.write_text(content, encoding="utf-8")
    return run(scenario(path))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return ran(tmp_path_factory.mktemp("plain"), QUICK)


def test_a_file_with_every_condition_is_simulate_with_every_keyword(
    tmp_path: Path, planar: ffsms.SpaceManipulator
) -> None:
    outcome = ran(
        tmp_path,
        text(*CONDITIONS)
        + '[[disturbance]]\nwrench = [0.01, 0, 0, 0, 0, 0]\non = "end-effector"\nend = inf\n'
        + "[watchdog]\nposition_margin_deg = 90.0\nrate_margin = inf\njoint_error = 2.0\nfailed_steps = 4\n",
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
        disturbances=[
            sim.Wrench([0.0, 0.0, 0.0, 0.0, 0.0, 0.01], "base", 0.5, 1.0),
            sim.Wrench([0.01, 0.0, 0.0, 0.0, 0.0, 0.0], "end-effector"),
        ],
        events=[
            sim.Capture(1.0, 0.5, [0.01, 0.01, 0.01], [0.05, 0.0, 0.0], [0.01, 0.0, 0.0, 0.0, 0.0, 0.02]),
            sim.JointFault(1.5, "joint_2", "limp", told=False),
        ],
        watchdog=sim.Watchdog(float(np.radians(90.0)), np.inf, 2.0, 4),
    )
    np.testing.assert_array_equal(outcome.tracking.q, by_hand.q)
    np.testing.assert_array_equal(outcome.tracking.tau, by_hand.tau)
    assert outcome.tracking.note == by_hand.note
    assert "captured 0.5 kg" in by_hand.note
    words = summary(outcome)["conditions"]
    assert set(words) >= {*CONDITIONS, "control", "reference", "watchdog"} - {"disturbance"}
    assert "disturbance 2" in words


@pytest.mark.parametrize("name", CONDITIONS)
def test_no_condition_goes_unheard(tmp_path: Path, plain: Outcome, name: str) -> None:
    outcome = ran(tmp_path, text(name))
    np.testing.assert_array_equal(outcome.trajectory.q, plain.trajectory.q)  # the plan knows nothing of it
    assert np.abs(outcome.tracking.q[-1] - plain.tracking.q[-1]).max() > 1e-7


def test_every_keyword_of_simulate_can_be_said() -> None:
    """The keys of the tables are the fields of the objects that `simulate` takes."""
    kinds: dict[str, tuple[type[Any], set[str]]] = {
        "friction": (sim.JointFriction, set()),
        "actuator": (sim.Actuator, set()),
        "sensors": (sim.Sensors, set()),
        "disturbance": (sim.Wrench, set()),
        "capture": (sim.Capture, set()),
        "fault": (sim.JointFault, set()),
        "watchdog": (sim.Watchdog, set()),
        "plant": (sim.InertialError, {"model", "end_effector"}),
    }
    for table, (kind, more) in kinds.items():
        assert set(TABLES[table].keys) == {field.name for field in fields(kind)} | more, table
    base = TABLES["plan"].tables["base_limits"]
    assert set(base.keys) == {field.name for field in fields(opt.BaseLimits)}
    random = set(signature(sim.random_plants).parameters) - {"sms", "rng", "count"}
    assert set(TABLES["plant"].tables["random"].keys) == random | {"seed"}
    options = set(signature(opt.plan).parameters) - {"sms", "q0", "target", "progress"}
    assert set(TABLES["plan"].keys) | {"base_limits"} == options | {"reach"}
    said = {"reference", "controller", "plant", "friction", "actuator", "sensors", "watchdog"}  # tables
    said |= {"disturbances", "events", "dt"}
    said |= TABLES["simulation"].keys.keys()
    assert set(signature(sim.simulate).parameters) - {"sms", "progress"} == said


@pytest.mark.parametrize("law", control.LAWS)
def test_a_law_by_name_with_its_gains(tmp_path: Path, law: str, planar: ffsms.SpaceManipulator) -> None:
    values = {gain: 0.5 + 0.25 * i for i, gain in enumerate(gains_of(law))}
    lines = "".join(f"{gain} = {value}\n" for gain, value in values.items())
    outcome = ran(tmp_path, QUICK.replace('law = "computed-torque"\n', f'law = "{law}"\n{lines}'))
    assert type(outcome.controller) is control.LAWS[law]
    wanted = control.LAWS[law](planar, **({"dt": 0.01} if law == "super-twisting" else {}), **values)
    for gain in values:
        np.testing.assert_array_equal(getattr(outcome.controller, gain), getattr(wanted, gain))
    by_hand = sim.simulate(planar, outcome.trajectory, wanted, dt=0.01)
    np.testing.assert_array_equal(outcome.tracking.tau, by_hand.tau)


def test_planning_again_has_its_own_rate_and_the_plan_made_once_stands_beside_it(
    tmp_path: Path, planar: ffsms.SpaceManipulator
) -> None:
    outcome = ran(
        tmp_path,
        QUICK.replace("duration = 2.0", "duration = 4.0\nkappa = 5.0")
        + '[reference]\nkind = "re-planning"\ndt = 0.02\nhold = 0.5\n[plant]\narm_mass = 1.3\n',
    )
    reference = opt.StepPlanner(planar, dt=0.02, kappa=5.0).track([0.75, 0.5, 0.0], 4.0, 0.5)
    plant, law = sim.perturb(planar, arm_mass=1.3), control.ComputedTorque(planar)
    q0 = outcome.trajectory.q[0]
    again = sim.simulate(planar, reference, law, dt=0.01, q0=q0, plant=plant)
    np.testing.assert_array_equal(outcome.tracking.q, again.q)
    assert outcome.tracking.t[-1] == pytest.approx(4.5)
    assert outcome.open_loop is not None
    once = sim.simulate(planar, outcome.trajectory, law, dt=0.01, plant=plant)
    rows = len(once.t)
    np.testing.assert_allclose(outcome.open_loop.tracking.q[:rows], once.q, rtol=0.0, atol=1e-14)
    assert outcome.open_loop.tracking.t[-1] == pytest.approx(4.5)  # the plan's end is held, too
    numbers = summary(outcome)["tracking"]
    assert numbers["final_error_m"] == again.position_error[-1]
    assert numbers["open_loop"]["final_error_m"] == outcome.open_loop.tracking.position_error[-1]
    assert numbers["open_loop"]["final_error_m"] > 3.0 * numbers["final_error_m"]


def test_an_open_loop_that_is_stopped_is_reported_and_stops_nothing_else(tmp_path: Path) -> None:
    """A joint locks: planning again goes on with what is left, the plan made once leaves the joint behind."""
    outcome = ran(
        tmp_path,
        QUICK.replace("duration = 2.0", "duration = 6.0")
        + '[reference]\nkind = "re-planning"\n[watchdog]\njoint_error = 0.05\n'
        + "[[fault]]\ntime = 1.0\njoint = 1\n",
    )
    assert outcome.open_loop is not None
    assert "joint_2' is 0.05" in outcome.open_loop.stopped
    report = summary(outcome)["tracking"]["open_loop"]
    assert report["arrived"] is False
    assert report["stopped"] == outcome.open_loop.stopped
    assert outcome.tracking.t[-1] == pytest.approx(6.0)
    assert "joint 'joint_2' has failed" in outcome.note


def test_random_plants_are_those_of_their_seed(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    outcome = ran(tmp_path, QUICK + "[plant]\nbase_mass = 1.1\n[plant.random]\nseed = 3\narm_mass = 0.5\n")
    start = sim.perturb(planar, base_mass=1.1)
    (drawn,) = sim.random_plants(start, np.random.default_rng(3), 1, arm_mass=0.5)
    wanted = [float(body.mass) for body in drawn.model.inertias]
    assert [float(body.mass) for body in outcome.plant.model.inertias] == wanted
    other = ran(tmp_path, QUICK + "[plant]\nbase_mass = 1.1\n[plant.random]\nseed = 4\narm_mass = 0.5\n")
    assert [float(body.mass) for body in other.plant.model.inertias] != wanted


def test_a_plant_from_another_file(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    from ffsms_pin.urdf import model_path

    urdf = Path(model_path("planar_3r")).read_text(encoding="utf-8")
    mass = re.search(r'<mass value="(31[^"]*)"', urdf)
    assert mass is not None
    (tmp_path / "light.urdf").write_text(urdf.replace(mass.group(0), '<mass value="20.0"'), encoding="utf-8")
    outcome = ran(tmp_path, QUICK + '[plant]\nmodel = "light.urdf"\narm_mass = 1.1\n')
    masses = [float(body.mass) for body in outcome.plant.model.inertias]
    model = [float(body.mass) for body in planar.model.inertias]
    assert masses[1] == 20.0
    np.testing.assert_allclose(masses[2:], 1.1 * np.array(model[2:]))


def test_the_start_may_be_any_state(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.41, 0.69, -0.5])
    q0[:2] += [0.02, -0.01]
    v0 = np.array([0.001, 0.0, 0.0, 0.0, 0.0, 0.002, 0.01, 0.0, -0.01])
    outcome = ran(tmp_path, QUICK + f"[simulation]\nq0 = {q0.tolist()}\nv0 = {v0.tolist()}\n")
    np.testing.assert_array_equal(outcome.tracking.q[0], q0)
    np.testing.assert_array_equal(outcome.tracking.v[0], v0)


def test_momentum_of_the_plan_is_the_plants_unless_it_has_its_own(tmp_path: Path) -> None:
    momentum = [0.01, 0.0, 0.0, 0.0, 0.0, 0.002]
    content = QUICK.replace("[control]", f"momentum = {momentum}\n[control]")
    outcome = ran(tmp_path, content)
    np.testing.assert_allclose(outcome.trajectory.momentum, momentum)
    np.testing.assert_allclose(outcome.tracking.momentum[-1], momentum, rtol=0.0, atol=1e-10)
    assert summary(outcome)["tracking"]["end_effector_deviation_max_m"] < 1e-4
    still = ran(tmp_path, content + "[simulation]\nmomentum = [0, 0, 0, 0, 0, 0]\n")
    assert np.abs(still.tracking.momentum).max() < 1e-10
    assert summary(still)["tracking"]["end_effector_deviation_max_m"] > 1e-3


def test_planning_again_knows_limits_of_the_base_and_momentum(
    tmp_path: Path, planar: ffsms.SpaceManipulator
) -> None:
    momentum = [0.0, 0.0, 0.0, 0.0, 0.0, 0.004]
    outcome = ran(
        tmp_path,
        QUICK.replace(
            "[control]", f"momentum = {momentum}\n[plan.base_limits]\nattitude_rate_deg = 1.0\n[control]"
        )
        + '[reference]\nkind = "re-planning"\n',
    )
    limits = opt.BaseLimits(attitude_rate=float(np.radians(1.0)))
    planner = opt.StepPlanner(planar, dt=0.05, base_limits=limits, momentum=momentum)
    by_hand = sim.simulate(
        planar,
        planner.track([0.75, 0.5, 0.0], 2.0),
        control.ComputedTorque(planar),
        dt=0.01,
        q0=outcome.trajectory.q[0],
        momentum=momentum,
    )
    np.testing.assert_array_equal(outcome.tracking.q, by_hand.q)


def test_base_limits_are_kept(tmp_path: Path, plain: Outcome) -> None:
    content = QUICK.replace('method = "resolved-rate"', 'method = "horizon"')
    free = summary(ran(tmp_path, content))["base"]
    limit = 0.5 * free["rotation_max_deg"]
    tight = ran(tmp_path, f"{content}[plan.base_limits]\nattitude_deg = {limit}\ntranslation = inf\n")
    assert summary(tight)["base"]["rotation_max_deg"] <= limit * (1.0 + 1e-6)


def test_a_watchdog_stops_the_run_and_saves_beside_the_file(
    tmp_path: Path, refused: Callable[..., FfsmsError]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(QUICK + "[plant]\narm_mass = 3.0\n[watchdog]\njoint_error = 1e-6\npath = 'stopped.npz'\n")
    refused(lambda: run(scenario(path)), SimulationStopped, "t = 0.", "off its reference", "stopped.npz")
    assert sim.Tracking.load(tmp_path / "stopped.npz").t[-1] < 2.0
    assert scenario(path).watchdog is not None
    path.write_text(QUICK)
    assert scenario(path).watchdog is None
    path.write_text(QUICK + "[watchdog]\n")  # as it is by default, and not none
    assert scenario(path).watchdog == {}


def test_a_recording_may_go_to_a_file_as_it_comes(tmp_path: Path, plain: Outcome) -> None:
    outcome = ran(tmp_path, QUICK + '[simulation]\nstream = "long.npz"\n')
    np.testing.assert_array_equal(outcome.tracking.q, plain.tracking.q)
    np.testing.assert_array_equal(sim.Tracking.load(tmp_path / "long.npz").q, plain.tracking.q)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[control]\nlaw = 'lqr'\n", ["[control] law", "must be one of", '"computed-torque"', "'lqr'"]),
        ("[control]\nlaw = 'pd'\nK_s = 1.0\n", ['[control] K_s is no gain of the law "pd"', "K_p, K_d"]),
        ("[control]\nlaw = 'pd'\nK_p = [[1,2,0],[2,1,0],[0,0,1]]\n", ["K_p", "positive definite"]),
        ("[control]\nlaw = 'pd'\nK_p = [1.0, 2.0]\n", ["K_p", "(3,)"]),
        ("[control]\nlaw = 'pd'\nK_d = -1.0\n", ["K_d", "above zero"]),
        ("[control]\nlaw = 'pd'\n[laws.pd]\nK_d = 1.0\n", ["[laws.pd]", "[control]"]),
        ("[laws.pd]\nGamma = 1.0\n", ["unknown key 'Gamma' in [laws.pd]", "K_d, K_p"]),
        ("[laws.lqr]\nK = 1.0\n", ["unknown key 'lqr' in [laws]", "sliding-mode"]),
        ("[reference]\nkind = 'replan'\n", ["[reference] kind", '"re-planning"']),
        ("[reference]\ndt = 0.1\n", ["[reference] dt", 'kind = "re-planning"']),
        ("[reference]\nkind = 're-planning'\nrate = 10\n", ["unknown key 'rate' in [reference]", "dt"]),
        ("[simulation]\nintegrator = 'euler'\n", ["[simulation] integrator", '"rk4"', "'euler'"]),
        ("[simulation]\nmomentum = [1, 2, 3]\n", ["[simulation] momentum", "6 numbers"]),
        ("[simulation]\nv0 = [0, 0]\n", ["v0", "(9,)"]),
        ("[simulation]\nq0 = [0, 0]\n", ["[simulation] q0", "(10,)"]),
        ("[simulation]\nq0 = [0,0,0,0,0,0,2,0,0,0]\n", ["[simulation] q0", "quaternion"]),
        ("[simulation]\nv0 = [0]\nmomentum = [0,0,0,0,0,0]\n", ["both v0 and momentum"]),
        ("[plant]\nmodel = 'space_arm_7'\n", ["plant", "joint_1, joint_2, joint_3"]),
        ("[plant]\nmodel = 'absent.urdf'\n", ["absent.urdf"]),
        ("[plant]\nend_effector = 'x'\n", ["[plant] end_effector", "model"]),
        ("[plant]\narm_mass = [1.0, 1.0]\n", ["arm_mass", "(3,)"]),
        ("[plant]\narm_mass = 0.0\n", ["[plant] arm_mass", "above zero"]),
        ("[plant]\nbase_com = [1.0]\n", ["[plant] base_com", "3 numbers"]),
        ("[plant]\nmas = 1.0\n", ["unknown key 'mas' in [plant]", "did you mean"]),
        ("[plant.random]\narm_mass = 0.1\n", ["[plant.random] seed is missing"]),
        ("[plant.random]\nseed = -1\n", ["[plant.random] seed", "whole number of at least 0"]),
        ("[plant.random]\nseed = 1\narm_mass = 1.5\n", ["arm_mass", "share"]),
        ("[friction]\nviscous = -1.0\n", ["[friction] viscous", "negative"]),
        ("[friction]\ncoulomb = [0.1]\n", ["coulomb", "(3,)"]),
        ("[friction]\nstatic = 1.0\n", ["unknown key 'static' in [friction]"]),
        ("[actuator]\ndelay = 5.0\n", ["actuator.delay", "duration of 2 s"]),
        ("[actuator]\ndelay = -0.1\n", ["[actuator] delay", "negative"]),
        ("[actuator]\ntorque_limit = [1.0]\n", ["actuator.torque_limit", "(3,)"]),
        ("[sensors]\nbase_latency = 2.5\n", ["sensors.base_latency", "duration of 2 s"]),
        ("[sensors]\njoint_noise = -1e-3\n", ["[sensors] joint_noise", "negative"]),
        ("[sensors]\njoint_noise = 1\njoint_noise_deg = 1\n", ["[sensors] has both joint_noise"]),
        ("[sensors]\nseed = 1.5\n", ["[sensors] seed", "whole number"]),
        ("[[disturbance]]\non = 'base'\n", ["[[disturbance]] 1 wrench is missing"]),
        ("[disturbance]\nwrench = [0,0,0,0,0,0]\n", ["write [[disturbance]]"]),
        ("[[disturbance]]\nwrench = [0,0,0,0,0,0]\non = 'arm'\n", ["[[disturbance]] 1 on", '"base"']),
        ("[[disturbance]]\nwrench = [0,0,0,0,0,0]\nstart = 2\nend = 1\n", ["wrench.end", "after its start"]),
        ("[[capture]]\ntime = 9\nmass = 1\ninertia = [1,1,1]\n", ["event.time", "2 s"]),
        ("[[capture]]\ntime = 1\nmass = 1\ninertia = [1,1,9]\n", ["capture.inertia", "rigid body"]),
        ("[[capture]]\ntime = 1\nmass = 0\ninertia = [1,1,1]\n", ["[[capture]] 1 mass", "above zero"]),
        ("[[fault]]\ntime = 1\njoint = 'joint_9'\n", ["fault.joint", "joint_9", "joint_1, joint_2, joint_3"]),
        ("[[fault]]\ntime = 1\njoint = 3\n", ["fault.joint", "3"]),
        ("[[fault]]\ntime = 1\njoint = 0\n[[fault]]\ntime = 1\njoint = -1\n", ["[[fault]] 2 joint"]),
        ("[[fault]]\ntime = 1\njoint = 0\ntold = 'no'\n", ["[[fault]] 1 told", "true or false"]),
        ("[[fault]]\ntime = 1\njoint = 0\nkind = 'loose'\n", ["[[fault]] 1 kind", '"limp"']),
        ("[watchdog]\nfailed_steps = 0\n", ["[watchdog] failed_steps", "at least 1"]),
        ("[plan]\nbase_limits = 3\n", ["write [plan.base_limits]"]),
        ("[plan.base_limits]\nattitude = 0\n", ["[plan.base_limits] attitude", "above zero"]),
        ("[plan.base_limits]\natitude = 1\n", ["'atitude' in [plan.base_limits]", "did you mean 'attitude'"]),
        ("[plan]\nmomentum = [1]\n", ["[plan] momentum", "6 numbers"]),
        ("wacthdog = {}\n", ["unknown table [wacthdog]", "did you mean 'watchdog'?"]),
    ],
)
def test_a_condition_that_cannot_be_used_is_named_before_anything_is_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, words: list[str]
) -> None:
    monkeypatch.setattr(opt, "plan", lambda *_, **__: pytest.fail("planned"))
    path = tmp_path / "mine.toml"
    base = QUICK.replace('[control]\nlaw = "computed-torque"\ndt = 0.01\n', "")
    if content.startswith("[plan]"):
        content = content.removeprefix("[plan]\n") + base[base.index("[plan]") :].replace("[plan]", "")
        content = base[: base.index("[plan]")] + "[plan]\n" + content
    elif content.startswith("wacthdog"):
        content += base
    else:
        content = base + content
    path.write_text(content, encoding="utf-8")
    with pytest.raises(FfsmsError) as caught:
        run(scenario(path))
    message = str(caught.value)
    assert "\n" not in message
    if "absent.urdf" not in message:
        assert type(caught.value) is InvalidScenario
    for word in [str(tmp_path), *words]:
        assert word in message


def test_every_key_is_documented() -> None:
    """docs/scenarios.md has a line for every key, under its table."""
    document = (Path(__file__).parents[1] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^## \[+([\w.]+)\]+[^\n]*\n(.*?)(?=^## |\Z)", document, re.S | re.M))
    for name, table in TABLES.items():
        if name == "laws":
            assert "laws" in sections
            continue
        for title, inner in ((name, table), *((f"{name}.{key}", one) for key, one in table.tables.items())):
            keys = set(re.findall(r"^\| `(\w+)`", sections[title], re.M))
            assert keys == set(inner.keys), title
