"""Run a fixed sample of the trials."""

from __future__ import annotations

import sys

import pytest

from trials.judge import GOOD
from trials.runner import run

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


# The trials are divided so that several processes can share them.
@pytest.mark.slow
@pytest.mark.long  # `make kernels` runs a sample in .ci/run
@pytest.mark.parametrize(
    ("kind", "first", "count"),
    [
        ("urdfs", 0, 60),
        ("urdfs", 60, 60),
        ("scenarios", 80, 60),
        ("calls", 0, 400),
        ("kills", 0, 1),
    ],
)
def test_every_trial_ends_in_a_result_or_in_a_library_error(kind: str, first: int, count: int) -> None:
    verdicts = list(run(kind, count, first))
    assert [verdict.seed for verdict in verdicts] == list(range(first, first + count))
    bad = [verdict for verdict in verdicts if verdict.outcome not in GOOD]
    assert not bad, "\n".join(map(str, bad))
    if kind != "kills":  # trials that are all refused would test little
        assert {verdict.outcome for verdict in verdicts} >= set(GOOD)
