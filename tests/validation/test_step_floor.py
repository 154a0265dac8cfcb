"""Test that the functions that the benchmark of a planning step measures by name exist."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest


def test_the_parts_of_a_step_are_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    step_floor = importlib.import_module("step_floor")
    for part, (place, names) in step_floor.PARTS.items():
        for name in names:
            assert callable(getattr(place, name, None)), f"{part}: {name}"
