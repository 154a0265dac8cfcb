"""Values that a seed draws from the distributions of a scenario file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffsms_pin.campaigns.draws import drawn_columns, drawn_content, flat_draws
from ffsms_pin.errors import FfsmsError, InvalidScenario

SEEDS = range(4000)


def columns(table: dict[str, Any]) -> dict[str, Any]:
    """Return the values drawn by all seeds, by column."""
    rows = [drawn_columns(dict(flat_draws(table)), seed) for seed in SEEDS]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def test_distributions_have_their_moments() -> None:
    drawn = columns({"a": {"uniform": [2.0, 5.0]}, "b": {"normal": [1.0, 0.1]}})
    values = drawn["draw.a"]
    assert 2.0 <= values.min() < 2.01
    assert 4.99 < values.max() <= 5.0
    assert values.mean() == pytest.approx(3.5, abs=0.05)
    values = drawn["draw.b"]
    assert values.mean() == pytest.approx(1.0, abs=0.01)
    assert values.std() == pytest.approx(0.1, rel=0.05)


def test_choices_are_equally_likely() -> None:
    values = columns({"law": {"choice": ["pd", "impedance", "pd"]}})["draw.law"]
    assert (values == "impedance").mean() == pytest.approx(1 / 3, abs=0.03)


def test_choices_that_are_no_numbers_are_columns_of_text() -> None:
    drawn = columns(
        {"a": {"choice": [{}, {"time": 1.0}]}, "b": {"choice": [1.0, 2.0]}, "c": {"choice": [[1]]}}
    )
    assert set(drawn["draw.a"]) == {"{}", '{"time": 1.0}'}
    assert set(drawn["draw.b"]) == {1.0, 2.0}
    assert set(drawn["draw.c"]) == {"[1]"}


def test_vectors_are_drawn_entry_by_entry() -> None:
    drawn = columns({"target": {"position": {"uniform": [[0.0, 1.0, 3.0], [1.0, 2.0, 3.0]]}}})
    assert list(drawn) == [f"draw.target.position.{i}" for i in range(3)]
    values = np.array(list(drawn.values())).T
    assert (values >= [0.0, 1.0, 3.0]).all()
    assert (values <= [1.0, 2.0, 3.0]).all()
    assert abs(np.corrcoef(values[:, 0], values[:, 1])[0, 1]) < 0.05


def test_a_draw_does_not_depend_on_the_others() -> None:
    alone = columns({"b": {"uniform": [0.0, 1.0]}})
    both = columns({"a": {"uniform": [0.0, 1.0]}, "b": {"uniform": [0.0, 1.0]}})
    assert (alone["draw.b"] == both["draw.b"]).all()
    assert (both["draw.a"] != both["draw.b"]).all()
    assert len(set(alone["draw.b"])) == len(SEEDS)


def test_a_drawn_value_replaces_that_of_the_file() -> None:
    content = {"start": {"joints_deg": [1.0]}, "fault": [{"time": 1.0}, {"time": 2.0}], "sensors": {}}
    draws = {
        "start.joints": {"uniform": [[0.5], [0.5]]},
        "fault.1": {"choice": [{}]},
        "fault.2.time": {"uniform": [3.0, 3.0]},
        "plant.arm_mass": {"normal": [1.2, 0.0]},
    }
    drawn = drawn_content(Path("file"), content, draws, 1)
    seed = drawn["sensors"].pop("seed")
    assert seed != drawn_content(Path("file"), content, draws, 2)["sensors"]["seed"]
    assert drawn == {
        "start": {"joints": [0.5]},
        "fault": [{"time": 3.0}],
        "sensors": {},
        "plant": {"arm_mass": 1.2},
    }
    assert content["fault"] == [{"time": 1.0}, {"time": 2.0}]


@pytest.mark.parametrize(
    "table",
    [
        {"a": {}},
        {"a": [0.0, 1.0]},
        {"a": {"uniform": 1.0}},
        {"a": {"choice": "abc"}},
        {"a": {"b": {"uniform": [0, 1], "normal": [0, 1]}}},
        {"a": {"uniform": [1.0, 2.0, 3.0]}},
        {"a": {"uniform": ["low", "high"]}},
        {"a": {"uniform": [2.0, 1.0]}},
        {"a": {"normal": [0.0, -1.0]}},
        {"a": {"choice": []}},
    ],
)
def test_invalid_distributions_are_refused(table: dict[str, Any], refused: Callable[..., FfsmsError]) -> None:
    draws = dict(flat_draws(table))
    key = next(iter(draws))
    refused(
        lambda: drawn_content(Path("file"), {"a": {}}, draws, 1),
        InvalidScenario,
        f"[campaign.draw] {key} = ",
        "cannot be drawn",
        "{ uniform = [low, high] }",
    )
