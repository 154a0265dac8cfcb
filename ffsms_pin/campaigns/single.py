"""`campaign`: many runs of one scenario into a folder; `replayed_scenario`: one of them again.

Each is planned, followed in closed loop, and told in one row of numbers.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.campaigns.definition import Campaign
from ffsms_pin.checks import instance, whole
from ffsms_pin.engine import ChunkFolder, Chunks, Shard, Table, run
from ffsms_pin.engine.cluster import ALLOWED_FAILURES
from ffsms_pin.errors import FfsmsWarning, InvalidValue, ResultError, SimulationDiverged, SimulationStopped
from ffsms_pin.extras import require
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.motion.motions import ARRIVAL_SHARE
from ffsms_pin.scenarios import Scenario
from ffsms_pin.scenarios.closed_loop import ClosedLoop, controller, planned, prepared
from ffsms_pin.scenarios.run import flown
from ffsms_pin.simulation import Tracking
from ffsms_pin.studies.numbers import base_numbers, joint_error_numbers
from ffsms_pin.system import SpaceManipulator

OUTCOMES = ("arrived", "missed", "stopped", "failed", "killed")
"""Within reach of the target at the end, or with the client caught; not so; stopped by a watchdog or a state
that is not finite; ended by an error; ended with its worker."""

METRICS = (
    "plan_cost_integral_s",
    "plan_final_error_m",
    "end_time_s",
    "final_error_m",
    "error_over_last_10_percent_m",
    "joint_error_max_rad",
    "joint_error_final_rad",
    "joint_rate_error_max_rad_per_s",
    "joint_error_max_m",
    "joint_error_final_m",
    "joint_rate_error_max_m_per_s",
    "torque_max",
    "base_translation_max_m",
    "base_rotation_max_deg",
    "linear_momentum_change_kg_m_per_s",
    "angular_momentum_change_kg_m2_per_s",
)
"""Numbers of a run, NaN where there is none."""


ARRIVED, MISSED, STOPPED, FAILED, KILLED = OUTCOMES
# Tables that no plan depends on: runs that differ in these alone share it.
_OF_THE_LOOP: tuple[str, ...] = ("control", "laws", "reference", "plant", "friction", "actuator", "sensors")
_OF_THE_LOOP += ("wrist", "estimator", "disturbance", "capture", "fault", "watchdog", "attitude")


def campaign(
    of: Campaign,
    folder: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    shard: Shard | None = None,
    progress: Callable[[int, int], None] | None = None,
    allowed_failures: int = ALLOWED_FAILURES,
) -> ChunkFolder:
    """Run a campaign, or go on with one that was killed.

    The table does not depend on jobs, scheduler and shards, bit for bit.

    Parameters
    ----------
    of : Campaign
    folder : path
        For the results. `merge` makes one table of it when all runs are done.
    jobs, scheduler, shard, allowed_failures
        As for `ffsms_pin.engine.run`.
    progress : callable, optional
        Called with the number of runs done and of all runs of this call.

    Raises
    ------
    ResultError
        The folder cannot be written, or holds another campaign.
    ClusterError, DependencyMissing
        As for `ffsms_pin.engine.run`. A run that fails is no error: it is a row with its error.
    """
    instance("campaign", of, Campaign)
    require("cluster", "a campaign")
    work = CampaignRuns(of)
    return run(
        work,
        Chunks.fitting(of.runs),
        folder,
        specification=of.specification(),
        where=of.where,
        jobs=jobs,
        scheduler=scheduler,
        shard=shard,
        lost=work.lost,
        progress=progress,
        allowed_failures=allowed_failures,
    )


def replayed_scenario(folder: str | os.PathLike[str], seed: int, *, allow_import: bool = False) -> Scenario:
    """The scenario of one run of a campaign, to be run alone.

    Parameters
    ----------
    folder : path
        Of the campaign.
    seed : int
        As in the column `seed` of its table.
    allow_import : bool
        As for `ffsms_pin.scenario`.

    Raises
    ------
    ResultError
        The folder holds no campaign.
    InvalidValue
        No run of it has that seed.
    """
    place = ChunkFolder(folder)
    try:
        found = Campaign.from_specification(place.specification, place.where, allow_import)
    except (KeyError, TypeError, ValueError):
        raise ResultError(place.path, "holds results, but not of a campaign") from None
    if whole("seed", seed, 0) not in range(found.seed, found.seed + found.runs):
        last = found.seed + found.runs - 1
        raise InvalidValue("seed", seed, f"must be one of the campaign's, {found.seed} to {last}")
    return found.scenario(seed)


@dataclass(frozen=True)
class CampaignRuns:
    """The work of the engine: the rows of a range of runs."""

    campaign: Campaign

    def __call__(self, rows: range) -> Table:
        """The table of some runs; one that raises an error is a row with its error."""
        last: dict[str, Any] = {}
        return table_of(self.campaign, [(row, self._row(row, last)) for row in rows])

    def lost(self, row: int, why: str) -> Table:
        """The row of a run that killed its worker."""
        return table_of(self.campaign, [(row, {"outcome": KILLED, "error": why})])

    def _row(self, row: int, last: dict[str, Any]) -> dict[str, Any]:
        try:
            chosen = self.campaign.scenario(self.campaign.seed + row)
            with chosen.named(), warnings.catch_warnings():
                warnings.simplefilter("ignore", FfsmsWarning)  # one for each of a million runs helps nobody
                return _numbers(chosen, last)
        except Exception as error:  # whatever it is, the other runs go on
            return {"outcome": FAILED, "error": f"{type(error).__name__}: {error}"}


def _plan_of(chosen: Scenario, sms: SpaceManipulator, q0: Any, last: dict[str, Any]) -> Trajectory:
    """The plan of a scenario; the last one, where nothing of it differs."""
    key = [one for name, one in chosen.tables.items() if name not in _OF_THE_LOOP]
    if last.get("key") != key:
        last.update(plan=planned(chosen, sms, q0, None), key=key)
    plan: Trajectory = last["plan"]
    return plan


def _numbers(chosen: Scenario, last: dict[str, Any]) -> dict[str, Any]:
    """Outcome and metrics of one run."""
    sms = chosen.load()
    q0 = chosen.start_configuration(sms)
    law = controller(chosen, sms)
    loop = prepared(chosen, sms, q0)
    plan = _plan_of(chosen, sms, q0, last)
    stopped, capture = "", None
    try:
        tracking, capture = flown(loop, plan, loop.reference(plan), law)
    except (SimulationDiverged, SimulationStopped) as error:
        tracking, stopped = error.tracking, str(error)
    there = tracking.arrived if capture is None else capture.caught
    return {
        "outcome": STOPPED if stopped else ARRIVED if there else MISSED,
        "error": stopped,
        "plan_reached": plan.reached,
        "plan_cost_integral_s": plan.cost_integral,
        "plan_final_error_m": float(plan.position_error[-1]),
        **_tracked(loop, plan, tracking),
    }


def _tracked(loop: ClosedLoop, plan: Trajectory, tracking: Tracking) -> dict[str, float]:
    """Metrics of a closed loop, as far as it went."""
    if len(tracking.t) < 2:
        return {}
    late = tracking.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    base = base_numbers(loop.plant, tracking.q)
    momentum = tracking.momentum - tracking.momentum[0]
    numbers = {
        "end_time_s": float(tracking.t[-1]),
        "final_error_m": float(tracking.position_error[-1]),
        "error_over_last_10_percent_m": float(tracking.position_error[late].max()) if late.any() else np.nan,
        "torque_max": float(np.abs(tracking.tau).max()),
        "base_translation_max_m": base["translation_max_m"],
        "base_rotation_max_deg": base["rotation_max_deg"],
        "linear_momentum_change_kg_m_per_s": float(np.linalg.norm(momentum[:, :3], axis=1).max()),
        "angular_momentum_change_kg_m2_per_s": float(np.linalg.norm(momentum[:, 3:], axis=1).max()),
        **joint_error_numbers(loop.sms, tracking),
    }
    return {name: value for name, value in numbers.items() if name in METRICS}


def table_of(campaign: Campaign, found: Sequence[tuple[int, Mapping[str, Any]]]) -> dict[str, Any]:
    """Columns of some runs, each found as its number and its outcome, error and metrics."""
    seeds = [campaign.seed + row for row, _ in found]
    rows = [values for _, values in found]
    drawn = [drawn_columns(campaign, seed) for seed in seeds]
    return {
        "run": np.array([row for row, _ in found], dtype=np.int64),
        "seed": np.array(seeds, dtype=np.int64),
        **{f"draw.{name}": np.array([one[name] for one in drawn]) for name in drawn[0]},
        "outcome": np.array([row["outcome"] for row in rows]),
        "error": np.array([row.get("error", "") for row in rows]),
        "plan_reached": np.array([bool(row.get("plan_reached", False)) for row in rows]),
        **{name: np.array([row.get(name, np.nan) for row in rows], dtype=np.float64) for name in METRICS},
    }


def drawn_columns(campaign: Campaign, seed: int) -> dict[str, float | str]:
    """What a seed draws, one entry a column: vectors entry by entry, counted from 0, and choices as text.

    Choices among numbers stay numbers.
    """
    columns: dict[str, float | str] = {}
    for draw in campaign.draws:
        value = draw.value(seed)
        if draw.kind == "choice":
            numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in draw.values)
            text = value if isinstance(value, str) else json.dumps(value)
            columns[draw.key] = float(value) if numbers else text
        elif isinstance(value, list):
            columns |= {f"{draw.key}.{i}": entry for i, entry in enumerate(value)}
        else:
            columns[draw.key] = value
    return columns
