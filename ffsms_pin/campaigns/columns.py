"""The columns of a campaign's table: the same for every run, whatever became of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ffsms_pin.campaigns.definition import Campaign

OUTCOMES = ("arrived", "missed", "stopped", "failed", "killed")
"""Within reach of the target at the end; not so; stopped by a watchdog or a state that is not finite; ended
by an error; ended with its worker."""

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
