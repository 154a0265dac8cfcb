"""Every pair of tables of scenario files: runs end in a result, or the file is refused."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from ffsms_pin.campaigns import Campaign
from ffsms_pin.campaigns.rows import run_numbers
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import Admittance
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios import closed_loop, run, scenario, summary
from ffsms_pin.simulation import Reference

# Most of these tests use the same plans.
pytestmark = pytest.mark.usefixtures("kept_plans")

BASE = """
robot = {model = "planar_3r"}
start = {joints = [0.4, 0.7, -0.5]}
[plan]
duration = 1.0
dt = 0.1
{plan}
[control]
{law}
dt = 0.02
"""
TARGET = '[target]\nposition = [0.01, 0.005, 0.0]\nrelative_to = "start"\n'
CLIENT = """
[client]
mass = 20.0
inertia = [1.0, 1.0, 1.0]
joints = [0.42, 0.72, -0.48]
{sensor}
[meet]
standoff = 0.0
"""
TABLES = {
    "also": (
        '[[also]]\nframe = "link_2"\nposition = [0.0, 0.0, 0.0]\nrelative_to = "start"\ntolerance = 0.1\n'
    ),
    "via": '[[via]]\nposition = [0.005, 0.0, 0.0]\nrelative_to = "start"\nreach = 0.03\ntime = 0.5\n',
    "path": '[path]\ncurve = "line"\nend = [0.01, 0.005, 0.0]\nrelative_to = "start"\n',
    "client": CLIENT,
    "contact": (
        '[contact]\nkind = "compliant"\ntime = 0.1\nafter = 0.5\n[contact.envelope]\nspin_deg = 5.0\n'
    ),
    "nozzle": "[contact.nozzle]\nstiffness = 1.0\n",
    "ring": "[contact.ring]\nstiffness = 1.0\n",
    "term": '[[term]]\nuse = "base-turn"\nweight = 0.1\n',
    "limit": '[[limit]]\nuse = "alpha-box"\n',
    "obstacle": '[[obstacle]]\nshape = "sphere"\nradius = 0.1\nposition = [-2.0, 0.0, 0.0]\n',
    "limits": "[limits]\nacceleration = 1.0\n",
    "replanning": '[reference]\nkind = "re-planning"\ndt = 0.1\n',
    "hold": "[reference]\nhold = 0.5\n",
    "simulation": '[simulation]\nintegrator = "variational"\n',
    "plant": "[plant]\narm_mass = 1.1\n",
    "random": "[plant.random]\nseed = 1\narm_mass = 0.02\n",
    "wheels": (
        "[wheels]\naxes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ninertia = 0.001\ntorque = 1.0\nmomentum = 5.0\n"
    ),
    "thrusters": (
        "[thrusters]\nplaces = [[0.2, 0.2, 0.0], [0.2, -0.2, 0.0], [-0.2, 0.2, 0.0], [-0.2, -0.2, 0.0]]\n"
        "directions = [[0, -1, 0], [0, 1, 0], [0, -1, 0], [0, 1, 0]]\nforce = 1.0\nproportional = true\n"
    ),
    "attitude": "[attitude]\n",
    "dump": "[attitude.dump]\n",
    "mode": 'mode = "rotation-floating"\n',
    "base limits": "base_limits = {attitude_deg = 20.0}\n",
    "momentum": "momentum = [0.001, 0.0, 0.0, 0.0, 0.0, 0.0]\n",
    "friction": "[friction]\nviscous = 0.01\ncoulomb = 0.001\n",
    "actuator": "[actuator]\ndelay = 0.02\nrate_limit = 50.0\n",
    "sensors": "[sensors]\njoint_noise = 1e-5\nbase_latency = 0.02\n",
    "wrist": "[wrist]\nforce_noise = 0.01\nlatency = 0.02\n",
    "impedance": 'law = "impedance"\nstiffness = 5.0\nturn_stiffness = 0.5',
    "admittance": 'law = "admittance"\nstiffness = 5.0\nturn_stiffness = 0.5\nmass = 2.0',
    "estimator": "[estimator]\n",
    "disturbance": "[[disturbance]]\nwrench = [0.01, 0, 0, 0, 0, 0]\nend = 0.5\n",
    "capture": "[[capture]]\ntime = 0.5\nmass = 0.2\ninertia = [0.01, 0.01, 0.01]\n",
    "fault": "[[fault]]\ntime = 0.5\njoint = 2\n",
    "guards": "[guards]\n",
    "learn": '[learn]\nunknown = ["base"]\n',
}
IN_PLAN = ("mode", "base limits", "momentum")
LAWS = ("admittance", "impedance")
# Tables that a table needs; a file without them is refused.
NEEDED = {
    "admittance": ["wrist"],
    "contact": ["client"],
    "nozzle": ["client"],
    "ring": ["client"],
    "attitude": ["wheels", "mode"],
    "thrusters": ["attitude", "wheels", "mode"],
    "dump": ["wheels", "thrusters", "mode"],
    "learn": ["replanning"],
    "mode": ["wheels", "attitude"],
}


# Pairs of tables that exclude each other, and a part of the message.
REFUSED = {
    frozenset({"capture", "client"}): "[[capture]]",
    frozenset({"nozzle", "ring"}): "keep one",
    frozenset({"client", "learn"}): "[learn]",
    frozenset({"client", "path"}): "[meet] and [path] exclude each other",
    frozenset({"client", "hold"}): "[reference] hold is not for a capture",
}


def _with_needed(names: Iterable[str]) -> set[str]:
    """Return some tables and those that they need."""
    return set(names).union(*(NEEDED.get(name, ()) for name in names))


def _text(names: set[str]) -> str:
    """Return a scenario with some tables, and with those that they need."""
    names = _with_needed(names)
    plan = "".join(TABLES[name] for name in TABLES if name in names and name in IN_PLAN)
    rest = "".join(TABLES[name] for name in TABLES if name in names and name not in (*IN_PLAN, *LAWS))
    law = next((TABLES[name] for name in LAWS if name in names), 'law = "computed-torque"')
    if {"replanning", "hold"} <= names:
        rest = rest.replace("[reference]\nhold = 0.5\n", "").replace(
            "[reference]\n", "[reference]\nhold = 0.5\n"
        )
    if {"attitude", "dump"} <= names:
        rest = rest.replace("[attitude]\n[attitude.dump]", "[attitude.dump]")
    if "client" in names:
        faults = "outliers = 0.1\ndropouts = 0.1\nhidden = [[0.2, 0.4]]\n"
        # Small noise, because a planar arm would search in vain for a plan to a client outside its plane.
        noise = "position_noise = 1e-5\nattitude_noise = 1e-5\noutlier_size = 1000.0\n"
        sensor = f"[client.sensor]\nseed = 1\n{noise}{faults}[client.belief]\nmass_deviation = 0.1\n"
        rest = rest.replace("{sensor}", sensor)
        if len(names) > 1 and "contact" not in names:  # the default is ten seconds, ten times the motion
            rest += "[contact]\nafter = 0.5\n"
    elif "path" not in names:
        rest = TARGET + rest
    return BASE.replace("{plan}", plan).replace("{law}", law) + rest


def _refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, names: set[str]) -> str:
    """Run a scenario; return the message if the scenario is refused before planning, else an empty text."""
    path = tmp_path / "short.toml"
    path.write_text(_text(names), encoding="utf-8")
    planned: list[bool] = []
    real = closed_loop.ClosedLoop.reference

    def recorded(self: closed_loop.ClosedLoop, plan: Trajectory) -> Reference:
        planned.append(True)
        return real(self, plan)

    monkeypatch.setattr(closed_loop.ClosedLoop, "reference", recorded)
    try:
        outcome = run(scenario(path))
    except InvalidScenario as error:
        message = str(error)
    else:
        message = ""
    if message:
        assert not planned, f"{sorted(names)}: refused after the planning: {message}"
        assert "\n" not in message
        return message
    numbers = summary(outcome)
    assert np.isfinite(outcome.tracking.q).all()
    assert (numbers.get("capture") is not None) == bool(names & {"client", "contact", "nozzle", "ring"})
    return ""


def _groups(size: int = 20) -> list[tuple[str, ...]]:
    """Return groups of tables in which every pair that can be together is in one group at least."""
    every = [frozenset(pair) for pair in itertools.combinations(sorted(TABLES), 2)]
    excluded = {
        pair for pair in every if any(two <= _with_needed(pair) for two in (frozenset(LAWS), *REFUSED))
    }
    remaining = dict.fromkeys(pair for pair in every if pair not in excluded)
    # The estimator of this robot restarts with a latched client.
    groups: list[tuple[str, ...]] = [("client", "replanning", "sensors")]
    while remaining:
        group = set(next(iter(remaining)))
        while len(group) < size:
            fits = [
                table for table in TABLES if not any(frozenset({table, other}) in excluded for other in group)
            ]
            gain = {
                table: sum(frozenset({table, other}) in remaining for other in group)
                for table in fits
                if table not in group
            }
            group.add(max(gain, key=lambda table: gain[table]))
        for pair in itertools.combinations(group, 2):
            remaining.pop(frozenset(pair), None)
        groups.append(tuple(sorted(group)))
    return groups


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("group", _groups(), ids=" + ".join)
def test_every_table_with_every_other(
    group: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _refusal(tmp_path, monkeypatch, set(group)) == ""


# The order of a frozenset differs from process to process, and tests need one name in all of them.
@pytest.mark.parametrize(
    ("pair", "fragment"), REFUSED.items(), ids=lambda x: x if isinstance(x, str) else " + ".join(sorted(x))
)
def test_tables_that_exclude_each_other_are_refused(
    pair: frozenset[str], fragment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert fragment in _refusal(tmp_path, monkeypatch, set(pair))


def _each_once() -> list[tuple[str, ...]]:
    """Return groups of tables in which every table is at least once."""
    groups: list[tuple[str, ...]] = []
    for group in _groups():
        if not set(group) <= {name for chosen in groups for name in chosen}:
            groups.append(group)
    return groups


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("group", _each_once(), ids=" + ".join)
def test_every_table_in_a_campaign(group: tuple[str, ...], tmp_path: Path) -> None:
    path, draw = tmp_path / "short.toml", "plant.base_mass = { uniform = [0.99, 1.01] }"
    path.write_text(f"{_text({*group, 'plant'})}[campaign.draw]\n{draw}\n")
    numbers = run_numbers(Campaign.read(path, 1).scenario(1))
    # A pushed arm may be stopped by a guard, with its reason.
    assert numbers["error"] == "" or numbers["error"].startswith("stopped at ")
    assert np.isfinite(numbers["final_error_m"])


def test_a_fault_after_the_end_of_a_capture_does_not_happen(tmp_path: Path) -> None:
    text = _text({"client", "fault"})
    late = text.replace("time = 0.5\njoint", "time = 3.9\njoint")
    assert late != text
    path = tmp_path / "late.toml"
    path.write_text(late, encoding="utf-8")
    outcome = run(scenario(path))
    assert outcome.capture is not None
    assert "locked" not in outcome.capture.tracking.note


def test_a_law_observes_the_contact_in_a_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[tuple[float, FloatArray]] = []
    monkeypatch.setattr(Admittance, "observe_wrench", lambda _, t, wrench: received.append((t, wrench)))
    path = tmp_path / "observed.toml"
    text = _text({"client", "contact", "admittance"}).replace("force_noise = 0.01\nlatency = 0.02", "")
    path.write_text(text, encoding="utf-8")
    outcome = run(scenario(path))
    assert outcome.capture is not None
    tracking = outcome.capture.whole
    forces = np.linalg.norm(tracking.contact_wrench[:, :3], axis=1)
    assert forces.max() > 0.0
    assert [t for t, _ in received] == tracking.t[: len(received)].tolist()
    # Sizes are compared, because the axes differ. The gripper closes after the wrist is measured in its step.
    # After the latch the law has the client's inertia, so the wrench that carries the client is removed.
    observed = np.array([np.linalg.norm(wrench[:3]) for _, wrench in received])
    forces, latched = forces[: len(observed)], outcome.capture.latched_at
    before = (forces > 0.0) & (tracking.t[: len(observed)] < latched - 1e-9)
    both = before & (observed > 0.0)
    assert both.sum() >= before.sum() - 1 > 1
    np.testing.assert_allclose(observed[both], forces[both], rtol=1e-9)
    after = tracking.t[: len(observed)] > latched + 1e-9
    assert forces[after].any()
    assert not observed[after].any()


def test_an_estimator_outlives_a_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimator restarts with the joined robot in the middle of a run."""
    assert (
        _refusal(tmp_path, monkeypatch, {"client", "contact", "sensors", "replanning", "wheels", "attitude"})
        == ""
    )
