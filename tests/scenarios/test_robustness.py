"""`robustness` and `ffsms-pin robustness`: one scenario on many plants that are not its model."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import untidy
from scenario_files import IN_RADIANS, write

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation
from ffsms_pin.cli import main
from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError
from ffsms_pin.plotting.comparisons import plot_robustness
from ffsms_pin.scenarios import Robustness, robustness, scenario
from ffsms_pin.scenarios.plants import METHODS, robustness_numbers

module = sys.modules["ffsms_pin.scenarios.plants"]

SCENARIO = f"""{IN_RADIANS}\
[plan]
duration = 4.0
dt = 0.05
method = "resolved-rate"
[control]
law = "computed-torque"
dt = 0.005
[plant]
base_mass = 2.0
"""
PLANTS = 3


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("scenario"), SCENARIO, "short.toml")


@pytest.fixture(scope="module")
def found(file: Path) -> Robustness:
    return robustness(scenario(file), PLANTS, seed=5, arm_mass=0.4, jobs=1)


def test_both_methods_meet_the_plants_of_the_seed(found: Robustness, planar: ffsms.SpaceManipulator) -> None:
    """By hand: the same plants around the model, whatever [plant] says."""
    plants = simulation.random_plants(planar, np.random.default_rng(5), PLANTS, arm_mass=0.4)
    for i, plant in enumerate(plants):
        law = control.ComputedTorque(planar)
        once = simulation.simulate(planar, found.plan, law, dt=0.005, plant=plant)
        again = simulation.simulate(
            planar,
            opt.Replanning(
                opt.StepPlanner(planar, dt=0.05).track([0.75, 0.5, 0.0], 4.0).problem, plan=found.plan
            ),
            law,
            dt=0.005,
            q0=found.plan.q[0],
            plant=plant,
        )
        for method, run in (("plan made once", once), ("re-planning", again)):
            assert found.final_errors(method)[i] == run.position_error[-1]
            middle = len(found.t) // 2
            assert found.distance[method][i, middle] == run.position_error[2 * middle]
            assert run.t[2 * middle] == pytest.approx(found.t[middle])
            assert found.arrived[method][i] == (run.position_error[-1] <= 0.02)
    assert found.t[0] == 0.0
    assert found.t[-1] == 4.0


def test_numbers(found: Robustness) -> None:
    numbers = robustness_numbers(found)
    assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers
    assert numbers["largest_relative_error"] == {"arm_mass": 0.4, "base_mass": 0.1, "base_inertia": 0.1}
    for method in METHODS:
        errors, row = found.final_errors(method), numbers["methods"][method]
        assert row["final_errors_m"] == errors.tolist()
        assert row["final_error_median_m"] == sorted(errors)[1]
        assert row["final_error_worst_m"] == row["final_error_95_percent_m"] == max(errors)
        assert row["arrived"] == int((errors <= 0.02).sum())
    again, once = (numbers["methods"][method]["final_error_median_m"] for method in METHODS)
    assert again < 0.2 * once


def test_processes_change_nothing(file: Path, found: Robustness) -> None:
    spread = robustness(scenario(file), PLANTS, seed=5, arm_mass=0.4, jobs=2)
    for method in METHODS:
        np.testing.assert_array_equal(spread.distance[method], found.distance[method])


def test_no_error_in_the_model_no_error_of_the_plan(file: Path) -> None:
    exact = robustness(scenario(file), 1, arm_mass=0.0, base_mass=0.0, base_inertia=0.0, jobs=1)
    planned = float(exact.plan.position_error[-1])
    assert exact.final_errors("plan made once")[0] == pytest.approx(planned, abs=1e-5)


def test_runs_that_are_stopped_count_as_such(tmp_path: Path) -> None:
    path = tmp_path / "strict.toml"
    path.write_text(SCENARIO + "[watchdog]\njoint_error = 1e-9\n")
    found = robustness(scenario(path), 2, jobs=1)
    numbers = robustness_numbers(found)
    json.dumps(numbers, allow_nan=False)
    for method in METHODS:
        row = numbers["methods"][method]
        assert (row["stopped"], row["arrived"]) == (2, 0)
        assert row["final_error_worst_m"] is None
        assert all("off its reference" in why for why in found.stopped[method])
        assert np.isfinite(found.distance[method][:, 0]).all()
    assert untidy(plot_robustness(found)) == []


def test_the_figure_shows_bands_and_shares(found: Robustness) -> None:
    figure = plot_robustness(found)
    assert untidy(figure) == []
    above, below = figure.axes
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [*METHODS, f"90 % of {PLANTS} plants", "reach, 20 mm"]
    for curve, method in zip(above.get_lines(), METHODS, strict=False):
        median = np.median(found.distance[method], axis=0)
        np.testing.assert_allclose(np.asarray(curve.get_ydata()), median)
    for curve, method in zip(below.get_lines(), METHODS, strict=False):
        errors = 1e3 * np.sort(found.final_errors(method))
        np.testing.assert_allclose(np.asarray(curve.get_xdata())[1:], errors)
        np.testing.assert_allclose(np.asarray(curve.get_ydata()), np.arange(PLANTS + 1) / PLANTS)
    figure.draw_without_rendering()
    for ax in figure.axes:
        assert "[" in ax.get_ylabel()
        box = ax.get_tightbbox()
        assert box is not None
        assert box.x0 >= -1.0
        assert box.x1 <= figure.bbox.width + 1.0


def test_runs_that_are_done_are_not_made_again(
    file: Path,
    found: Robustness,
    tmp_path: Path,
    refused: Callable[..., FfsmsError],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Stop(Exception):
        pass

    def stop(stage: str, share: float) -> None:
        if stage == "plants" and share > 0.0:
            raise Stop

    kept = tmp_path / "kept"
    again = partial(robustness, scenario(file), PLANTS, seed=5, arm_mass=0.4, jobs=1, folder=kept)
    with pytest.raises(Stop):
        again(progress=stop)
    made = []
    run = module._end

    def counted(*given: Any) -> Any:
        made.append(given)
        return run(*given)

    monkeypatch.setattr(module, "_end", counted)
    whole = again()
    assert len(made) == len(METHODS) * (PLANTS - 1)
    for method in METHODS:
        np.testing.assert_array_equal(whole.distance[method], found.distance[method])
    refused(lambda: robustness(scenario(file), PLANTS, seed=6, jobs=1, folder=kept), ResultError, "seed")


def test_the_share_that_arrived_has_an_interval(found: Robustness) -> None:
    for row in robustness_numbers(found)["methods"].values():
        low, high = row["arrived_95_percent_interval"]
        assert 0.0 <= low <= row["arrived"] / PLANTS <= high <= 1.0
        assert low < high


def test_the_command(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "results"
    arguments = ["--plants", "2", "--seed", "3", "--jobs", "1", "--base-mass", "0.3", "--out", str(out)]
    assert main(["robustness", str(file), *arguments]) == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "robustness.json",
        "robustness.pdf",
        "robustness.png",
    ]
    numbers = json.loads((out / "robustness.json").read_text())
    assert (numbers["plants"], numbers["seed"]) == (2, 3)
    assert numbers["largest_relative_error"]["base_mass"] == 0.3
    captured = capsys.readouterr()
    for word in (*METHODS, "2 random plants", "of 2", "median", "worst", str(out)):
        assert word in captured.out
    # On a loaded machine a stage has more lines than one, every few seconds.
    stages = [line.split(":")[0] for line in captured.err.splitlines()]
    assert list(dict.fromkeys(stages)) == ["planning", "plants"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--plants", "0"], ["--plants", "at least 1"]),
        (["--seed", "-1"], ["--seed", "at least 0"]),
        (["--arm-mass", "1.0"], ["--arm-mass", "below 1"]),
        (["--jobs", "0"], ["--jobs"]),
        (["--plants", "many"], ["--plants", "many"]),
    ],
)
def test_arguments_that_cannot_be_used(
    file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: list[str],
) -> None:
    out = tmp_path / "results"
    assert main(["robustness", str(file), "--out", str(out), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for word in words:
        assert word in error
    assert not out.exists()


def test_wrong_counts_in_python(file: Path, refused: Callable[..., FfsmsError]) -> None:
    refused(lambda: robustness(scenario(file), plants=True), InvalidValue, "plants")
    refused(lambda: robustness(scenario(file), seed=1.5), InvalidValue, "seed")  # type: ignore[arg-type]
