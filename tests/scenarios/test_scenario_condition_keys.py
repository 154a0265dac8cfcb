"""Keys of real conditions in a scenario file: complete, documented, and named if they are invalid."""

from __future__ import annotations

import re
import runpy
from dataclasses import fields
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
from condition_files import QUICK

import ffsms_pin as ffsms
from ffsms_pin import opt, simulation as sim
from ffsms_pin.control import MomentumDump, QuaternionFeedback, StationKeeping
from ffsms_pin.errors import FfsmsError, InvalidScenario
from ffsms_pin.opt.plans import PlanOptions
from ffsms_pin.options.tables import Keys, models_in
from ffsms_pin.scenarios import closed_loop, run, scenario
from ffsms_pin.scenarios.tables import ScenarioFile


def _models(*path: str) -> list[type[Keys]]:
    """Return the models of a table, or of a table inside it: one model for each choice."""
    models: list[type[Keys]] = [ScenarioFile]
    for name in path:
        models = models_in(models[0].model_fields[name].annotation)
    return models


def _keys(*path: str) -> set[str]:
    """Return the keys of a table without the tables inside it."""
    fields = {name: field for model in _models(*path) for name, field in model.model_fields.items()}
    return {name for name, field in fields.items() if not models_in(field.annotation)}


def test_every_keyword_of_simulate_is_a_key() -> None:
    """The keys of the tables are the fields of the objects that `simulate` takes."""
    kinds: dict[str, tuple[type[Any], set[str]]] = {
        "friction": (sim.JointFriction, set()),
        "actuator": (sim.Actuator, set()),
        "sensors": (sim.Sensors, set()),
        "wrist": (sim.WristSensor, set()),
        "estimator": (sim.Estimator, {"on"}),
        "disturbance": (sim.Wrench, set()),
        "capture": (sim.Capture, set()),
        "fault": (sim.JointFault, set()),
        "guards": (sim.Guards, {"on"}),
        "wheels": (ffsms.ReactionWheels, set()),
        "thrusters": (ffsms.Thrusters, set()),
        "plant": (sim.InertialError, {"model", "end_effector"}),
    }
    for table, (kind, more) in kinds.items():
        assert _keys(table) == {field.name for field in fields(kind)} | more, table
    assert _keys("plan", "base_limits") == {field.name for field in fields(opt.BaseLimits)}
    random = set(signature(sim.random_plants).parameters) - {"sms", "rng", "count"}
    assert _keys("plant", "random") == random | {"seed"}
    options = set(signature(opt.plan).parameters) - {"sms", "q0", "target", "progress", "options"}
    options |= set(PlanOptions.__annotations__)
    options -= {"obstacles", "wheel_momentum"}  # keys of other tables
    options -= {"also", "via"}  # for Python only
    assert _keys("plan") | {"base_limits", "joint_rates"} == options | {"reach"}
    assert "joint_rates" in _keys("start")
    # The coast is the time that [contact] leaves before braking.
    assert _keys("meet") == {field.name for field in fields(opt.Meet)} - {"client", "coast"} | {"grasp_rpy"}
    keys = {"reference", "controller", "plant", "friction", "actuator", "sensors", "wrist", "estimator"}
    keys |= {"guards"}  # tables
    keys |= {"disturbances", "events", "dt", "base_controller"}
    keys |= {"client", "loads", "supervisor"}  # [client] and [contact]
    laws = (QuaternionFeedback, StationKeeping)
    law = {name for kind in laws for name in signature(kind).parameters} - {"sms"}
    assert {name for model in _models("attitude") for name in model.model_fields} == law | {"law"}
    assert _keys("attitude", "dump") == set(signature(MomentumDump).parameters)
    keys |= _keys("simulation")
    arguments = set(signature(sim.simulate).parameters) | {field.name for field in fields(sim.Conditions)}
    assert arguments - {"sms", "progress", "conditions", "fields"} == keys


@pytest.mark.parametrize(
    ("content", "fragments"),
    [
        ("[control]\nlaw = 'lqr'\n", ["[control] law", "must be one of", '"computed-torque"', "'lqr'"]),
        ("[control]\nlaw = 'pd'\nK_s = 1.0\n", ['[control] K_s is no option of law = "pd", which takes K_p']),
        ("[control]\nlaw = 'pd'\nK_p = [[1,2,0],[2,1,0],[0,0,1]]\n", ["K_p", "positive definite"]),
        ("[reference]\nkind = 'replan'\n", ["[reference] kind", '"re-planning"']),
        ("[control]\nlaw = 'pd'\nGama = 1.0\n", ["unknown key 'Gama' in [control]", "did you mean 'Gamma'?"]),
        ("[contact]\nkind = 'soft'\n", ["[contact] kind must be one of", '"compliant"', "'soft'"]),
        ("[attitude]\ndump = 3\n", ["'attitude.dump' must be a table: write [attitude.dump]"]),
        ("[[term]]\nweight = 1.0\n", ["[[term]] 1 use is missing"]),
        ("obstacle = 3\n", ["write [[obstacle]]"]),
        ("[reference]\ndt = 0.1\n", ["[reference] dt", 'kind = "re-planning"']),
        ("[estimator]\non = true\n", ["[estimator] needs a table [sensors]"]),
        (
            "[control]\nlaw = 'pd'\nboundary = 0.1\n",
            ['boundary is no option of law = "pd"'],
        ),
        ("[simulation]\nintegrator = 'euler'\n", ["[simulation] integrator", '"rk4"', "'euler'"]),
        ("[simulation]\nq0 = [0,0,0,0,0,0,2,0,0,0]\n", ["[simulation] q0", "quaternion"]),
        ("[simulation]\nv0 = [0]\nmomentum = [0,0,0,0,0,0]\n", ["both v0 and momentum"]),
        ("[plant]\nmodel = 'space_arm_7'\n", ["plant", "joint_1, joint_2, joint_3"]),
        ("[plant]\nmodel = 'absent.urdf'\n", ["absent.urdf"]),
        ("[plant]\nend_effector = 'x'\n", ["[plant] end_effector", "model"]),
        ("[plant]\nmas = 1.0\n", ["unknown key 'mas' in [plant]", "did you mean"]),
        ("[plant.random]\narm_mass = 0.1\n", ["[plant.random] seed is missing"]),
        ("[plant.random]\nseed = 1\narm_mass = 1.5\n", ["arm_mass", "share"]),
        ("[friction]\nviscous = -1.0\n", ["[friction] viscous", "from 0 to 1e+09 [N m s/rad]"]),
        ("[actuator]\ndelay = 5.0\n", ["[actuator] delay", "duration of 2 s"]),
        ("[sensors]\nbase_latency = 2.5\n", ["[sensors] base_latency", "duration of 2 s"]),
        ("[sensors]\njoint_noise = 1\njoint_noise_deg = 1\n", ["[sensors] has both joint_noise"]),
        ("[wrist]\nbias = [0.1]\n", ["[wrist] bias", "6 numbers"]),
        ("[control]\nlaw = 'admittance'\n", ["[control] law", "admittance", "[wrist]"]),
        ("[estimator]\non = 'yes'\n", ["[estimator] on", "true or false"]),
        ("[reference]\nkind = 're-planning'\njerk = [1.0]\n", ["[reference] jerk", "3 joints"]),
        ("[[disturbance]]\non = 'base'\n", ["[[disturbance]] 1 wrench is missing"]),
        ("[disturbance]\nwrench = [0,0,0,0,0,0]\n", ["write [[disturbance]]"]),
        (
            "[[disturbance]]\nwrench = [0,0,0,0,0,0]\nstart = 2\nend = 1\n",
            ["[[disturbance]] 1 end", "after its start"],
        ),
        ("[[capture]]\ntime = 9\nmass = 1\ninertia = [1,1,1]\n", ["[[capture]] 1 time", "2 s"]),
        (
            "[[capture]]\ntime = 1\nmass = 1\ninertia = [1,1,9]\n",
            ["[[capture]] 1 inertia", "triangle inequality"],
        ),
        (
            "[[fault]]\ntime = 1\njoint = 'joint_9'\n",
            ["[[fault]] 1 joint", "joint_9", "joint_2, joint_3"],
        ),
        ("[[fault]]\ntime = 1\njoint = 0\n[[fault]]\ntime = 1\njoint = -1\n", ["[[fault]] 2 joint"]),
        ("[guards]\nfailed_steps = 0\n", ["[guards] failed_steps", "at least 1"]),
        ("[plan]\nbase_limits = 3\n", ["write [plan.base_limits]"]),
        ("[plan.base_limits]\natitude = 1\n", ["'atitude' in [plan.base_limits]", "did you mean 'attitude'"]),
        ("[goal]\nposition = [1, 0, 0]\n", ["unknown table [goal]", "did you mean 'target'?"]),
        ("gaurds = {}\n", ["unknown table [gaurds]", "did you mean 'guards'?"]),
    ],
)
def test_an_invalid_condition_is_named_before_planning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: str, fragments: list[str]
) -> None:
    monkeypatch.setattr(closed_loop, "plan_problem", lambda *_, **__: pytest.fail("planned"))
    path = tmp_path / "mine.toml"
    base = QUICK.replace('[control]\nlaw = "computed-torque"\ndt = 0.01\n', "")
    if content.startswith("[plan]"):
        content = content.removeprefix("[plan]\n") + base[base.index("[plan]") :].replace("[plan]", "")
        content = base[: base.index("[plan]")] + "[plan]\n" + content
    elif not content.startswith("["):
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
    for fragment in [str(tmp_path), *fragments]:
        assert fragment in message


def test_the_page_lists_the_keys_of_the_models() -> None:
    """docs/scenario-keys.md has the tables that docs/key_tables.py makes."""
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "scenario-keys.md").read_text(encoding="utf-8")
    with_key_tables = runpy.run_path(str(docs / "key_tables.py"))["with_key_tables"]
    assert with_key_tables(page) == page
    titles = set(re.findall(r"^## \[+([\w.]+)\]+$", page, re.M))
    for name, field in ScenarioFile.model_fields.items():
        assert name in titles
        for inner, key in models_in(field.annotation)[0].model_fields.items():
            if models_in(key.annotation):
                assert f"{name}.{inner}" in titles
