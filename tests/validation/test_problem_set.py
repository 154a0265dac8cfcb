"""Test the problem set of the benchmark, its judge, and a violation of each limit."""

from __future__ import annotations

import ast
import copy
import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PROBLEMS = ROOT / "benchmarks" / "problems"
COUNTS = {"positions": 100, "poses": 100, "held": 70, "obstacles": 80, "clients": 60, "two_arms": 50}
COUNTS["momentum"] = 40
# The index of a problem of each family; that of "held" has both limits, that of "momentum" is spatial.
SAMPLE = {"positions": 1, "poses": 1, "held": 3, "obstacles": 1, "clients": 1, "two_arms": 2, "momentum": 5}

Plan = dict[str, Any]


def module(name: str) -> Any:
    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    return importlib.import_module(f"benchmarks.problems{name}")


@pytest.fixture(scope="module")
def judge() -> Any:
    return module(".judge")


@pytest.fixture(scope="module")
def drawn() -> dict[str, tuple[Plan, Plan]]:
    """Return a generated problem of each family and its witness."""
    generate = module(".generate")
    return {family: generate.made(family, index) for family, index in SAMPLE.items()}


def test_the_judge_is_short_and_does_not_import_the_library() -> None:
    text = (PROBLEMS / "judge.py").read_text()
    tree = list(ast.walk(ast.parse(text)))
    names = {alias.name for node in tree if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in tree if isinstance(node, ast.ImportFrom)}
    others = {name.partition(".")[0] for name in names} - set(sys.stdlib_module_names)
    assert others == {"numpy", "pinocchio"}
    assert len(text.splitlines()) <= 300


def test_there_are_500_problems_for_six_robots(judge: Any) -> None:
    problems = [problem for family in judge.FAMILIES for problem in judge.load(family)]
    assert {family: len(judge.load(family)) for family in judge.FAMILIES} == COUNTS
    assert len({problem["name"] for problem in problems}) == 500
    assert len({problem["robot"] for problem in problems}) == 6
    assert sum((PROBLEMS / f"{family}.jsonl").stat().st_size for family in COUNTS) < 1_000_000


@pytest.mark.long
@pytest.mark.slow
def test_the_problem_files_are_reproducible(judge: Any, drawn: dict[str, tuple[Plan, Plan]]) -> None:
    for family, (problem, _) in drawn.items():
        assert judge.load(family)[SAMPLE[family]] == problem
    robots = module(".robots")
    for robot in ("planar_3r", "two_arms"):
        texts = [(PROBLEMS / "robots" / f"{robot}.{suffix}").read_text() for suffix in ("urdf", "srdf")]
        assert tuple(texts) == robots.written(robot)


@pytest.mark.parametrize("family", COUNTS)
def test_a_witness_solves_its_problem(judge: Any, drawn: dict[str, tuple[Plan, Plan]], family: str) -> None:
    verdict = judge.judge(*drawn[family])
    assert verdict["solved"]
    assert verdict["exact"]
    assert not verdict["broken"]


def rippled(plan: Plan) -> Plan:
    """Return a plan with small and fast oscillations that violate only accelerations and torques."""
    size, fast = 5e-4, 60.0
    t = np.linspace(0.0, plan["t"][-1], 4000)
    joints = np.column_stack([np.interp(t, plan["t"], x) for x in plan["joints"].T])
    rates = np.column_stack([np.interp(t, plan["t"], x) for x in plan["rates"].T])
    ramp, wave = np.sin(np.pi * t / t[-1])[:, None] ** 2, np.sin(fast * t)[:, None]
    slope = (np.pi / t[-1]) * np.sin(2.0 * np.pi * t / t[-1])[:, None]
    joints = joints + size * ramp * wave
    return {
        "t": t,
        "joints": joints,
        "rates": rates + size * (slope * wave + fast * ramp * np.cos(fast * t)[:, None]),
    }


def hurried(plan: Plan) -> Plan:
    """Return the same motion in a third of the time, and then rest."""
    t = np.append(plan["t"] / 3.0, plan["t"][-1])
    joints, rates = (np.vstack([plan[key], plan[key][-1:]]) for key in ("joints", "rates"))
    return {"t": t, "joints": joints, "rates": 3.0 * rates}


def direct(plan: Plan) -> Plan:
    """Return a straight joint motion to the same end."""
    s = plan["t"] / plan["t"][-1]
    displacement = plan["joints"][-1] - plan["joints"][0]
    joints = plan["joints"][0] + (s**2 * (3.0 - 2.0 * s))[:, None] * displacement
    return {
        "t": plan["t"],
        "joints": joints,
        "rates": (6.0 * s * (1.0 - s))[:, None] * displacement / plan["t"][-1],
    }


def beyond(plan: Plan) -> Plan:
    """Return a plan with a joint that moves beyond its range and returns."""
    s = plan["t"] / plan["t"][-1]
    bump = np.zeros_like(plan["joints"])
    bump[:, 1] = 7.0 * np.sin(np.pi * s) ** 2
    slope = np.zeros_like(bump)
    slope[:, 1] = 7.0 * np.pi / plan["t"][-1] * np.sin(2.0 * np.pi * s)
    return {"t": plan["t"], "joints": plan["joints"] + bump, "rates": plan["rates"] + slope}


def moved(plan: Plan) -> Plan:
    return {**plan, "joints": plan["joints"] + 0.01}


def cut(plan: Plan) -> Plan:
    return {key: values[:-5] for key, values in plan.items()}


def undefined(plan: Plan) -> Plan:
    return {**plan, "rates": np.where(plan["t"][:, None] > 1.0, np.nan, plan["rates"])}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "change", "limit"),
    [
        ("poses", beyond, "range"),
        ("poses", hurried, "rate"),
        ("poses", rippled, "acceleration"),
        ("poses", rippled, "torque"),
        ("obstacles", direct, "clearance"),
        ("poses", beyond, "clearance"),
        ("held", direct, "base_attitude"),
        ("held", beyond, "base_translation"),
        ("poses", moved, "start"),
        ("poses", cut, "end"),
        ("poses", undefined, "rate"),
    ],
)
def test_a_plan_that_breaks_a_limit(
    judge: Any, drawn: dict[str, tuple[Plan, Plan]], family: str, change: Callable[[Plan], Plan], limit: str
) -> None:
    problem, witness = drawn[family]
    verdict = judge.judge(problem, change(witness))
    assert limit in verdict["broken"]
    assert not verdict["solved"]
    if change is rippled:
        assert verdict["broken"].keys() <= {"acceleration", "torque"}


def test_rates_between_nodes_count(judge: Any, drawn: dict[str, tuple[Plan, Plan]]) -> None:
    # The arm is at rest at both nodes and too fast between them.
    problem, witness = drawn["poses"]
    ends = {key: values[[0, -1]] for key, values in direct(witness).items()}
    quick = copy.deepcopy(problem) | {"duration": 1.0}
    assert "rate" in judge.judge(quick, ends | {"t": [0.0, 1.0]})["broken"]


def test_goals_that_are_missed(judge: Any, drawn: dict[str, tuple[Plan, Plan]]) -> None:
    problem, witness = drawn["poses"]
    slow = judge.judge(problem, direct(witness))
    assert not slow["arrived"]  # too late
    assert slow["misses"][0] < 1e-3
    turned = copy.deepcopy(problem)
    turned["goals"][0]["quaternion"][0] += 0.03
    verdict = judge.judge(turned, witness)
    assert not verdict["arrived"]
    assert not verdict["broken"]
    assert verdict["misses"][0] < 1e-6 < 0.02 < verdict["misses"][1]
    both, moves = drawn["two_arms"]
    other = copy.deepcopy(both)
    other["goals"][1]["position"][0] += 2e-3  # within reach, not within the tolerance
    assert not judge.judge(other, moves)["arrived"]
    assert judge.judge(other | {"goals": other["goals"][:1]}, moves)["arrived"]


def test_the_velocity_at_contact_is_judged(judge: Any, drawn: dict[str, tuple[Plan, Plan]]) -> None:
    problem, witness = drawn["clients"]
    faster, knock = copy.deepcopy(problem), np.array([0.0, 0.004, 0.0])
    client = faster["client"]
    client["twist"] = (np.array(client["twist"]) + np.append(knock, np.zeros(3))).tolist()
    client["position"] = (np.array(client["position"]) - problem["duration"] * knock).tolist()
    verdict = judge.judge(faster, witness)
    assert verdict["misses"][0] < 1e-5
    assert verdict["misses"][2] == pytest.approx(0.004, rel=1e-3)
    assert not verdict["arrived"]


@pytest.mark.slow
@pytest.mark.parametrize("family", COUNTS)
def test_the_judge_agrees_with_the_library(judge: Any, family: str) -> None:
    problem = judge.load(family)[SAMPLE[family]]
    library = module(".baselines.library")
    plan = library.planned(problem, 60.0)
    verdict = judge.judge(problem, plan)
    judged = {"reached": verdict["solved"], "exact": verdict["exact"], "kept": not verdict["broken"]}
    assert judged == plan["claimed"]
    made = library.plan_problem(library.stated(problem))
    assert verdict["cost"] == pytest.approx(made.cost_integral, rel=0.02, abs=1e-5)
    assert verdict["base_turn"] == pytest.approx(float(made.base_rotation.max()), abs=1e-5)
    assert verdict["travel"] == pytest.approx(made.joint_travel, rel=1e-3)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command, out = module(".__main__"), tmp_path / "rows.jsonl"
    options = ["--families", "held", "clients", "--limit", "1", "--out", str(out), "--solvers"]
    for solvers in (["null-space"], ["null-space", "resolved-rate"]):
        monkeypatch.setattr(sys, "argv", ["problems", *options, *solvers])
        command.main()
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert [(row["solver"], row["problem"]) for row in rows] == [
        ("null-space", "held-000"),
        ("null-space", "clients-000"),
        ("resolved-rate", "held-000"),
        ("resolved-rate", "clients-000"),
    ]
    assert [row["applies"] for row in rows] == [True, True, True, False]
    lines = out.with_suffix(".md").read_text().splitlines()
    cells = next(line for line in lines if line.startswith("| resolved-rate |")).split("|")
    assert [cell.strip() for cell in cells[2:9]] == ["", "", "0 of 1", "", "n/a", "", ""]
    assert json.loads(out.with_suffix(".json").read_text())["machine"]["cores"] >= 1


def test_an_unproven_clearance_is_not_counted_as_violated(judge: Any) -> None:
    """The clearance at instants is 10.1 mm, its bound between them 9.7 mm; 10 mm are required."""
    problem = judge.find("obstacles-015")
    plan = module(".baselines.library").planned(problem, 30.0, method="resolved-rate")
    assert "a clearance is not proven: wrist_yaw_body - cylinder 2 is at least 9.7 mm" in plan["note"]
    assert plan["claimed"] == {"reached": False, "exact": False, "kept": None}
    assert judge.judge(problem, plan)["broken"] == {}
