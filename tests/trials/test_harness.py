"""Test that the trials detect crashes, hangs, other errors, warnings and excessive memory."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import pytest

from ffsms_pin.errors import FfsmsError, InvalidValue, TasksFailed
from trials.judge import judged
from trials.rogue import ENDS
from trials.runner import run


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_every_kind_of_failure_is_detected_and_later_trials_run() -> None:
    verdicts = list(run("rogue", len(ENDS), limit=2.0))
    assert [verdict.outcome for verdict in verdicts] == [outcome for outcome, _ in ENDS]
    assert [verdict.seed for verdict in verdicts] == list(range(len(ENDS)))
    assert [verdict.what for verdict in verdicts] == [f"number {seed}" for seed in range(len(ENDS))]


def raising(error: BaseException) -> Callable[[], Any]:
    def work() -> None:
        raise error

    return work


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (InvalidValue("q", 1, "must be two"), "our error"),
        (FfsmsError(""), "other error"),
        (ValueError("q"), "other error"),
        (RecursionError(), "other error"),
        (MemoryError(), "memory"),
        (RuntimeWarning("q"), "warning"),
        (TasksFailed({0: InvalidValue("q", 1, "must be two")}, [None]), "our error"),
        (TasksFailed({0: KeyError("q")}, [None]), "other error"),
    ],
)
def test_errors_are_classified(error: BaseException, outcome: str) -> None:
    assert judged(raising(error))[0] == outcome
