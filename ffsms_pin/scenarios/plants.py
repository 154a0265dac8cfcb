"""One scenario on many plants that are not its model: planned again in the loop, and planned once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray, whole
from ffsms_pin.engine import Chunks, Table, collected, joined, run
from ffsms_pin.engine.cluster import checked_jobs
from ffsms_pin.errors import TaskError, TasksFailed
from ffsms_pin.files import read_content
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios.closed_loop import ClosedLoop, attempt, control_steps, controller, planned, prepared
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.replanning import replanning
from ffsms_pin.scenarios.run import StageProgress, check_call, stage
from ffsms_pin.simulation import random_plants
from ffsms_pin.studies.numbers import finite, wilson_interval
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.version import __version__

METHODS = ("re-planning", "plan made once")

_INSTANTS = 400  # of a run that are kept
# Of a run: distance (k,) [m], NaN from where it was stopped; whether it arrived; why it was stopped.
_End: TypeAlias = tuple[FloatArray, bool, str]
_COLUMNS = ("distance", "arrived", "stopped")


@dataclass(frozen=True, eq=False)
class Robustness:
    """Runs of one scenario on random plants, by two methods.

    Attributes
    ----------
    sms : SpaceManipulator
        The model.
    plan : Trajectory
        The plan made once.
    shares : dict of str to float
        By how much masses and inertias are off at most, as for `random_plants`.
    seed : int
    t : ndarray, shape (k,)
        Instants that were kept [s].
    distance : dict of str to ndarray, each of shape (plants, k)
        By method: distance from the end effector to the target [m], NaN from where a run was stopped.
    arrived : dict of str to ndarray of bool, each of shape (plants,)
        Whether the end effector ended within the plan's reach of the target.
    stopped : dict of str to list of str
        Why a run did not get to its end; empty where it did.
    """

    scenario: Scenario
    sms: SpaceManipulator
    plan: Trajectory
    shares: dict[str, float]
    seed: int
    t: FloatArray
    distance: dict[str, FloatArray]
    arrived: dict[str, np.ndarray[tuple[int], np.dtype[np.bool_]]]
    stopped: dict[str, list[str]]

    def final_errors(self, method: str) -> FloatArray:
        """Distance to the target at the end (plants,) [m]; infinite where a run was stopped."""
        ends = self.distance[method][:, -1]
        return np.where(np.isnan(ends), np.inf, ends)


def robustness(
    scenario: Scenario,
    plants: int = 200,
    seed: int = 1,
    *,
    arm_mass: float = 0.2,
    base_mass: float = 0.1,
    base_inertia: float = 0.1,
    jobs: int | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> Robustness:
    """Follow a scenario's motion on random plants, planned again in the loop and planned once.

    All else is the scenario's: its control law, sensors, friction and disturbances. Its [plant] is not used.
    Both methods meet the same plants.

    Parameters
    ----------
    plants : int
    seed : int
        Of the random plants.
    arm_mass, base_mass, base_inertia : float
        By what share they are off at most, as for `ffsms_pin.simulation.random_plants`.
    jobs : int, optional
        Processes at once; default: one for each core. The results do not depend on it.
    folder : path, optional
        Where runs are kept as they end, in chunks: the same call goes on from there where it was killed.
        Default: nothing is kept.
    progress : callable, optional
        Called with "planning" or "plants" and the share of that stage that is done, 0 to 1.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot.
    InvalidValue
        No plants, or a share out of range.
    TasksFailed
        Some runs raised errors; those that were stopped are no error.
    ResultError
        The folder cannot be written, or holds other runs.
    DependencyMissing
        Several processes are asked for, and Dask is not installed.
    """
    check_call(scenario, progress)
    plants, seed, jobs = whole("plants", plants, 1), whole("seed", seed, 0), checked_jobs(jobs)
    sms = scenario.load()
    shares = {"arm_mass": arm_mass, "base_mass": base_mass, "base_inertia": base_inertia}
    next(random_plants(sms, np.random.default_rng(seed), 1, **shares))  # shares out of range show up here
    with scenario.named():
        q0 = scenario.start_configuration(sms)
        loop = prepared(scenario, sms, q0)
        controller(scenario, sms)
        plan = planned(scenario, sms, q0, stage(progress, "planning"))
        report = stage(progress, "plants")
        counted = None if report is None else lambda done, total: report(done / total)
        work, chunks = _Runs(loop, plan, shares, seed), Chunks.fitting(plants)
        how: dict[str, Any] = {"jobs": jobs, "lost": work.lost, "progress": counted}
        if folder is None:
            found = collected(work, chunks, **how)
        else:
            place = run(work, chunks, folder, specification=_specification(work), **how)
            found = joined(list(place.tables()))
    failures: dict[int, Exception] = {
        int(i): TaskError(str(found["error"][i])) for i in np.flatnonzero(found["error"] != "")
    }
    if failures:
        rows = [{name: column[i] for name, column in found.items()} for i in range(plants)]
        raise TasksFailed(failures, [None if i in failures else row for i, row in enumerate(rows)])
    t = np.linspace(0.0, scenario.duration, control_steps(scenario) + 1)[_rows(scenario)]
    distance, ended, stopped = (
        {method: found[name][:, i] for i, method in enumerate(METHODS)} for name in _COLUMNS
    )
    why = {method: words.tolist() for method, words in stopped.items()}
    return Robustness(scenario, sms, plan, shares, seed, t, distance, ended, why)


def robustness_numbers(found: Robustness) -> dict[str, Any]:
    """What the runs come to, every key of a quantity ending in its unit; a stopped run has no final error."""
    numbers: dict[str, Any] = {
        "scenario": found.scenario.name,
        "plants": len(found.arrived[METHODS[0]]),
        "seed": found.seed,
        "largest_relative_error": dict(found.shares),
        "reach_m": found.plan.reach,
        "methods": {},
    }
    for method in METHODS:
        errors, number = found.final_errors(method), int(found.arrived[method].sum())
        numbers["methods"][method] = {
            "arrived": number,
            "arrived_95_percent_interval": list(wilson_interval(number, len(errors))),
            "stopped": sum(bool(why) for why in found.stopped[method]),
            "final_error_median_m": finite(np.median(errors)),
            "final_error_95_percent_m": finite(np.quantile(errors, 0.95, method="higher")),
            "final_error_worst_m": finite(errors.max()),
            "final_errors_m": [finite(error) for error in errors],
        }
    return numbers


@dataclass(frozen=True, eq=False)
class _Runs:
    """The work of the engine: each row is one plant, with its runs by method."""

    loop: ClosedLoop
    plan: Trajectory
    shares: dict[str, float]
    seed: int

    def __call__(self, rows: range) -> Table:
        """Runs on some plants; what raises an error is a row with its error."""
        # A draw takes a millisecond: those before the first row are made and left out.
        rng = np.random.default_rng(self.seed)
        drawn = islice(random_plants(self.loop.sms, rng, rows.stop, **self.shares), rows.start, None)
        return joined([self._row(plant) for plant in drawn])

    def lost(self, _: int, why: str) -> Table:
        """The row of a plant that killed its worker."""
        nothing = np.full(len(_rows(self.loop.scenario)), np.nan), False, ""
        return _table([nothing] * len(METHODS), why)

    def _row(self, plant: SpaceManipulator) -> Table:
        try:
            return _table([_end(self.loop, self.plan, method, plant) for method in METHODS], "")
        except Exception as error:  # whatever it is, the other plants go on
            return self.lost(0, f"{type(error).__name__}: {error}")


def _specification(work: _Runs) -> dict[str, Any]:
    """All that the rows depend on: the file, the robot, the plan, the plants' draws and the version."""
    scenario = work.loop.scenario
    robot = work.loop.sms.model.saveToString().encode()
    contents = {"file": read_content(scenario.source), "robot": robot, "plan": work.plan.q.tobytes()}
    return {
        "what": "robustness",
        "scenario": scenario.name,
        **{f"{name}_sha256": hashlib.sha256(content).hexdigest() for name, content in contents.items()},
        "largest_relative_error": work.shares,
        "seed": work.seed,
        "version": __version__,
    }


def _table(ends: Sequence[_End], error: str) -> dict[str, Any]:
    """One row: the runs on one plant, by method."""
    columns = zip(_COLUMNS, zip(*ends, strict=True), strict=True)
    return {**{name: np.array([column]) for name, column in columns}, "error": np.array([error])}


def _end(loop: ClosedLoop, plan: Trajectory, method: str, plant: SpaceManipulator) -> _End:
    """One run on one plant; law and reference are new, for some remember."""
    scenario, sms = loop.scenario, loop.sms
    reference = replanning(scenario, sms, plan) if method == METHODS[0] else loop.plan_once(plan)
    tracking, stopped = attempt(partial(loop.run, reference, controller(scenario, sms), plant=plant))
    whole = np.full(control_steps(scenario) + 1, np.nan)
    whole[: len(tracking.t)] = tracking.position_error
    return whole[_rows(scenario)], not stopped and tracking.arrived, stopped


def _rows(scenario: Scenario) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """The control steps that are kept, the first and the last among them."""
    steps = control_steps(scenario)
    return np.unique(np.linspace(0, steps, min(steps, _INSTANTS) + 1).round().astype(np.int64))
