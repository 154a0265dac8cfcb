"""What a seed draws from the distributions of a scenario file."""

from __future__ import annotations

import numpy as np
import pytest

from ffsms_pin.campaigns.definition import DrawError, read_draws

SEEDS = range(4000)


def test_distributions_have_their_moments() -> None:
    uniform, normal = read_draws({"a": {"uniform": [2.0, 5.0]}, "b": {"normal": [1.0, 0.1]}})
    values = np.array([uniform.value(seed) for seed in SEEDS])
    assert 2.0 <= values.min() < 2.01
    assert 4.99 < values.max() <= 5.0
    assert values.mean() == pytest.approx(3.5, abs=0.05)
    values = np.array([normal.value(seed) for seed in SEEDS])
    assert values.mean() == pytest.approx(1.0, abs=0.01)
    assert values.std() == pytest.approx(0.1, rel=0.05)


def test_choices_are_as_likely() -> None:
    (draw,) = read_draws({"law": {"choice": ["pd", "impedance", "pd"]}})
    values = [draw.value(seed) for seed in SEEDS]
    assert values.count("impedance") / len(values) == pytest.approx(1 / 3, abs=0.03)


def test_vectors_are_drawn_entry_by_entry() -> None:
    (draw,) = read_draws({"target": {"position": {"uniform": [[0.0, 1.0, 3.0], [1.0, 2.0, 3.0]]}}})
    assert draw.key == "target.position"
    values = np.array([draw.value(seed) for seed in SEEDS])
    assert values.shape == (len(SEEDS), 3)
    assert (values >= [0.0, 1.0, 3.0]).all()
    assert (values <= [1.0, 2.0, 3.0]).all()
    assert abs(np.corrcoef(values[:, 0], values[:, 1])[0, 1]) < 0.05


def test_a_draw_does_not_depend_on_the_others() -> None:
    alone = read_draws({"b": {"uniform": [0.0, 1.0]}})
    both = read_draws({"a": {"uniform": [0.0, 1.0]}, "b": {"uniform": [0.0, 1.0]}})
    assert [draw.key for draw in both] == ["a", "b"]
    assert alone[0].value(7) == both[1].value(7) != both[0].value(7)
    assert alone[0].value(7) != alone[0].value(8)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"a": 1.0}, "a must have one distribution"),
        ({"a": {}}, "a has no distribution"),
        ({"a": {"b": {"uniform": [0, 1], "normal": [0, 1]}}}, "a.b must have one distribution"),
        ({"a": {"uniform": [1.0]}}, "low and high"),
        ({"a": {"uniform": [1.0, [2.0, 3.0]]}}, "two lists of numbers of one length"),
        ({"a": {"uniform": [True, 2.0]}}, "two numbers"),
        ({"a": {"uniform": [0.0, 1e300]}}, "two numbers"),
        ({"a": {"uniform": [2.0, 1.0]}}, "low end above its high end"),
        ({"a": {"normal": [0.0, -1.0]}}, "standard deviation below zero"),
        ({"a": {"choice": []}}, "not empty"),
    ],
)
def test_distributions_that_cannot_be_used(table: dict[str, object], words: str) -> None:
    with pytest.raises(DrawError, match=words):
        read_draws(table)
