"""Terms and limits that a scenario file names, the keys of [plan] for them, and joint rates at the start."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import QUICK, write

from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.errors import FfsmsError, InvalidScenario, InvalidValue
from ffsms_pin.options.tables import OWN, models_in
from ffsms_pin.scenarios import run, scenario, summary
from ffsms_pin.scenarios.closed_loop import planned
from ffsms_pin.scenarios.comparisons import compare
from ffsms_pin.scenarios.problems import replanning
from ffsms_pin.scenarios.tables import PACKAGED, ScenarioFile

MODULE = """
from dataclasses import dataclass
import numpy as np
from ffsms_pin import opt

@dataclass(frozen=True)
class Quiet(opt.Term):
    joint: int
    weight: float = 1.0
    places: tuple = ()
    name = "quiet"

    def __post_init__(self):
        if self.weight < 0:
            raise ValueError("a weight below\\nzero")

    def residual(self, m):
        return self.weight**0.5 * m.rates[self.joint]

class Nameless(opt.Term):
    def residual(self, motions):
        return []

class Nothing(opt.Limit):
    name = "nothing"
    def rows(self, step):
        return None
    def residual(self, motions):
        return []
    def violation(self, motion):
        return opt.Violation()

answer = 42
"""


class _SearchBegins(Exception):
    """A sign that the search was about to begin."""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder with custom modules, which are unloaded afterwards."""
    (tmp_path / "my_parts.py").write_text(MODULE)
    (tmp_path / "broken_parts.py").write_text("import no_such_package")
    yield tmp_path
    for name in ("my_parts", "broken_parts"):
        sys.modules.pop(name, None)


def read_problem(path: Path, **options: Any) -> opt.Problem:
    chosen = scenario(path, **options)
    return chosen.problem(chosen.load())


def test_parts_by_short_names_replace_the_defaults(tmp_path: Path) -> None:
    plain = read_problem(write(tmp_path, QUICK))
    assert [term.name for term in plain.terms] == ["coupling", "smooth", "effort"]
    assert [limit.name for limit in plain.limits] == ["joints", "torques", "clearance"]
    more = (
        '[[term]]\nuse = "coupling"\nkappa = 5.0\n[[term]]\nuse = "base-turn"\nweight = 0.2\n'
        '[[limit]]\nuse = "base"\nattitude_deg = 10.0\n[[limit]]\nuse = "alpha-box"\n'
        '[[limit]]\nuse = "clearance"\nclearance = 0.02\ncollision = "shapes"\n'
    )
    problem = read_problem(write(tmp_path, QUICK + more))
    assert problem.terms == (opt.Smooth(), opt.Effort(), opt.Coupling(5.0), opt.BaseTurn(0.2))
    assert problem.kappa == 5.0
    joints, torques, base, box, clearance = problem.limits
    assert torques == opt.TorqueLimits()
    assert isinstance(joints, opt.JointLimits)
    assert isinstance(base, opt.BaseLimits)
    assert base.attitude == pytest.approx(np.radians(10.0))
    assert isinstance(box, opt.AlphaBox)
    assert isinstance(clearance, opt.Clearance)
    assert (clearance.clearance, clearance.collision) == (0.02, "shapes")


def test_every_packaged_part_has_a_table() -> None:
    """The names that a scenario file may use are those of the packaged classes."""
    for kind, parts in PACKAGED.items():
        (first, *_) = models_in(ScenarioFile.model_fields[kind].annotation)
        assert first.choices.keys() == {*parts, OWN}


def test_terms_of_a_base_that_is_held(tmp_path: Path) -> None:
    more = (
        '[[term]]\nuse = "wheel-momentum"\nweight = 2.0\n[[term]]\nuse = "wheel-energy"\nrounding = 0.01\n'
        '[[term]]\nuse = "propellant"\nweight = 0.3\n[[limit]]\nuse = "wheels"\n'
    )
    problem = read_problem(write(tmp_path, QUICK + more))
    expected = (opt.WheelMomentum(2.0), opt.WheelEnergy(rounding=0.01), opt.Propellant(0.3))
    assert problem.terms[-3:] == expected
    assert isinstance(problem.limits[-1], opt.WheelLimits)


def test_plan_keys_describe_the_same_parts(tmp_path: Path) -> None:
    keys = 'dt = 0.05\neffort = 1e-3\nbase = 0.2\ntime_limit = 9.0\nlocked = ["joint_2"]'
    path = write(tmp_path, QUICK.replace("dt = 0.05", keys, 1))
    problem = read_problem(path)
    assert problem.terms == (opt.Coupling(), opt.Smooth(), opt.Effort(1e-3), opt.BaseTurn(0.2))
    assert problem.locked == ("joint_2",)
    case = scenario(path)
    sms = case.load()
    plan = planned(case, sms, case.start_configuration(sms), None)
    assert np.ptp(plan.joint_positions[:, 1]) == 0.0
    assert np.ptp(plan.joint_positions[:, 0]) > 0.01


def test_the_time_limit_reaches_the_search(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[float | None] = []

    def record(problem: Any, method: str, options: opt.SearchOptions, progress: Any) -> None:
        limits.append(options.time_limit)
        raise _SearchBegins

    monkeypatch.setattr("ffsms_pin.scenarios.closed_loop.plan_problem", record)
    for text in (QUICK, QUICK.replace("dt = 0.05", "dt = 0.05\ntime_limit = 0.5", 1)):
        case = scenario(write(tmp_path, text))
        sms = case.load()
        with pytest.raises(_SearchBegins):
            planned(case, sms, case.start_configuration(sms), None)
    assert limits == [None, 0.5]


def test_joint_rates_at_the_start_are_the_plans_and_the_plants(tmp_path: Path) -> None:
    moving = QUICK.replace("[target]", "joint_rates_deg = [1.0, -2.0, 0.5]\n[target]").replace(
        "offset_deg = [0.5, 0.0, -0.5]\n", ""
    )
    outcome = run(scenario(write(tmp_path, moving)))
    rates = np.radians([1.0, -2.0, 0.5])
    np.testing.assert_allclose(outcome.trajectory.joint_rates[0], rates, atol=1e-15)
    np.testing.assert_allclose(outcome.tracking.v[0, 6:], rates, atol=1e-15)
    assert outcome.trajectory.reached
    again = scenario(write(tmp_path, moving + '[reference]\nkind = "re-planning"\n'))
    assert replanning(again, again.load()).sample(0.0)[1] == pytest.approx(rates)


def test_custom_parts_are_used_in_planning(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder / "elsewhere")
    before = list(sys.path)
    more = (
        '[[term]]\nuse = "my_parts:Quiet"\njoint = 0\nweight = 10.0\nplaces = [[1, 2], [3]]\n'
        '[[limit]]\nuse = "my_parts:Nothing"\n'
    )
    path = write(folder, QUICK + more)
    problem = read_problem(path, allow_import=True)
    quiet = problem.terms[-1]
    assert (quiet.joint, quiet.weight, quiet.places) == (0, 10.0, ((1, 2), (3,)))  # type: ignore[attr-defined]
    assert problem.limits[-1].name == "nothing"
    assert sys.path == before
    with_term = run(scenario(path, allow_import=True))
    without = run(scenario(write(folder, QUICK, "plain.toml")))
    assert with_term.trajectory.shares["quiet"] > 0.0
    travel = [np.abs(outcome.trajectory.joint_rates[:, 0]).mean() for outcome in (with_term, without)]
    assert travel[0] < 0.8 * travel[1]
    described = summary(with_term)["conditions"]
    assert described["term"].startswith("use my_parts:Quiet, joint 0")


def test_a_custom_limit_is_checked_in_the_flight(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A limit that only the flight violates: exit 1, with the reason."""
    slow = (
        "class Slow(opt.Limit):\n"
        '    name = "slow"\n'
        "    def rows(self, step):\n        return None\n"
        "    def residual(self, motions):\n        return []\n"
        "    def violation(self, motion):\n        return opt.Violation()\n"
        "    def violation_in_flight(self, motion):\n"
        "        turned = motion.joints[0].max() - motion.joints[0].min()\n"
        '        return opt.Violation(float(turned), note=f"the shoulder turned by {turned:.3f} rad")\n'
    )
    with (folder / "my_parts.py").open("a") as module:
        module.write(slow)
    path = write(folder, QUICK + '[[limit]]\nuse = "my_parts:Slow"\n')
    outcome = run(scenario(path, allow_import=True))
    assert outcome.trajectory.reached
    assert not outcome.tracking.arrived
    assert [miss for miss in outcome.tracking.misses if miss.startswith("the shoulder turned by")]
    assert main(["run", str(path), "--allow-import", "--no-figures", "--out", str(folder / "out")]) == 1
    assert "not arrived: the shoulder turned by" in capsys.readouterr().out


def test_nothing_is_imported_unless_allowed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(folder, QUICK + '[[term]]\nuse = "my_parts:Quiet"\njoint = 0\n')
    chosen = scenario(path)
    sms = chosen.load()
    with pytest.raises(InvalidScenario, match=r"would run the code .* allow_import=True"):
        chosen.problem(sms)
    for command in (["run"], ["compare", "--methods", "horizon"]):
        assert main([command[0], str(path), *command[1:], "--out", str(folder / "out")]) == 2
        assert "--allow-import" in capsys.readouterr().err
    assert "my_parts" not in sys.modules


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        (
            '[[term]]\nuse = "efort"\n',
            ["[[term]] 1 use must be one of", '"effort"', "did you mean 'effort'?", "got 'efort'"],
        ),
        ('[[term]]\nuse = "effort"\nwieght = 1\n', ["'wieght' in [[term]] 1", "did you mean 'weight'?"]),
        ('[[term]]\nuse = "effort"\nweight = -1\n', ["[[term]] 1 weight must be a finite number from 0 to"]),
        ('[[term]]\nuse = "smooth"\n[[term]]\nuse = "smooth"\n', ["terms", "must have different names"]),
        ('[[term]]\nuse = "my_parts:"\n', ["must be written package.module:Class"]),
        (
            '[[term]]\nuse = "broken_parts:Quiet"\n',
            ["cannot be imported", "'no_such_package'"],
        ),
        ('[[term]]\nuse = "my_parts:Loud"\n', ["module 'my_parts' has no Loud"]),
        ('[[term]]\nuse = "my_parts:answer"\n', ["is no subclass of opt.Term"]),
        (
            '[[term]]\nuse = "my_parts:Quiet"\n',
            ["missing a required key: 'joint' (its keys: joint, weight, "],
        ),
        (
            '[[term]]\nuse = "my_parts:Quiet"\njoint = 0\nweight = -1\n',
            ["a weight below zero"],
        ),
        ('[[term]]\nuse = "my_parts:Nameless"\n', ["has no `name`"]),
    ],
)
def test_an_invalid_part_is_refused_in_one_line(
    folder: Path, refused: Callable[..., FfsmsError], text: str, fragments: list[str]
) -> None:
    path = write(folder, QUICK + text)
    refused(lambda: read_problem(path, allow_import=True), InvalidScenario, str(path), *fragments)


@pytest.mark.parametrize(
    ("key", "part"),
    [
        ("kappa = 5.0", '[[term]]\nuse = "coupling"\n'),
        ("clearance = 0.02", '[[limit]]\nuse = "clearance"\n'),
        ("base_limits = {attitude = 0.1}", '[[limit]]\nuse = "base"\n'),
    ],
)
def test_a_value_set_twice_is_refused(
    tmp_path: Path, refused: Callable[..., FfsmsError], key: str, part: str
) -> None:
    path = write(tmp_path, QUICK.replace("dt = 0.05", f"dt = 0.05\n{key}", 1) + part)
    refused(lambda: scenario(path), InvalidScenario, str(path), key.split()[0], "set the same; keep one")


def test_another_module_of_the_same_name_is_refused(folder: Path, refused: Callable[..., FfsmsError]) -> None:
    text = QUICK + '[[term]]\nuse = "my_parts:Quiet"\njoint = 0\n'
    read_problem(write(folder, text), allow_import=True)
    other = folder / "other"
    other.mkdir()
    (other / "my_parts.py").write_text(MODULE.replace("joint: int", "joint: float"))
    path = write(other, text)
    refused(
        lambda: read_problem(path, allow_import=True), InvalidScenario, "another module 'my_parts' is loaded"
    )


def test_the_clearance_of_a_limit_is_reported(tmp_path: Path) -> None:
    text = QUICK + '[[limit]]\nuse = "clearance"\nclearance = 0.03\n'
    assert summary(run(scenario(write(tmp_path, text))))["clearance"]["required_m"] == 0.03
    text = QUICK + '[[limit]]\nuse = "clearance"\ncollision = "off"\n'
    assert summary(run(scenario(write(tmp_path, text))))["clearance"]["checked"] == "off"


def test_methods_that_do_not_support_a_part_are_left_out(tmp_path: Path) -> None:
    locked = QUICK.replace("dt = 0.05", 'dt = 0.05\nlocked = ["joint_3"]', 1)
    left = compare(scenario(write(tmp_path, locked))).left_out
    assert set(left) == set(opt.METHODS) - {"horizon"}
    assert left["step"] == "does not support locked joints"


@pytest.mark.parametrize(
    ("keys", "fragments"),
    [
        ('method = "paper"\neffort = 1e-3', ['[plan] effort needs [plan] method = "horizon"']),
        ('method = "step"\nbase = 0.1', ['[plan] base needs [plan] method = "horizon"']),
        ('method = "resolved-rate"\ntime_limit = 1.0', ["[plan] time_limit needs [plan] method"]),
    ],
)
def test_options_that_the_method_does_not_take_are_refused(
    tmp_path: Path, refused: Callable[..., FfsmsError], keys: str, fragments: list[str]
) -> None:
    path = write(tmp_path, QUICK.replace("dt = 0.05", f"dt = 0.05\n{keys}", 1))
    refused(lambda: scenario(path), InvalidScenario, str(path), *fragments)


def test_terms_that_the_method_does_not_take_are_refused(
    tmp_path: Path, refused: Callable[..., FfsmsError]
) -> None:
    text = QUICK.replace("dt = 0.05", 'dt = 0.05\nmethod = "paper"', 1) + '[[term]]\nuse = "effort"\n'
    refused(
        lambda: scenario(write(tmp_path, text)),
        InvalidScenario,
        '[[term]] is not for [plan] method = "paper"',
    )


def test_methods_to_compare_are_a_sequence_of_names(
    tmp_path: Path, refused: Callable[..., FfsmsError]
) -> None:
    bare: Any = "step"
    read = scenario(write(tmp_path, QUICK))
    refused(lambda: compare(read, bare), InvalidValue, "methods must be a sequence", "methods=['step']")
