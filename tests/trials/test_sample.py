"""A sample of the trials, the same in every run."""

from __future__ import annotations

import sys

import pytest

from trials.judge import GOOD
from trials.known import known_fault
from trials.runner import run

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


# In parts, so that several processes can share them.
@pytest.mark.parametrize(
    ("kind", "first", "count"),
    [
        ("urdfs", 0, 200),
        *(("scenarios", first, 100) for first in (0, 100)),
        *(("calls", first, 250) for first in (0, 250)),
        ("kills", 0, 2),
    ],
)
def test_every_trial_ends_in_a_result_or_in_an_error_of_ours(kind: str, first: int, count: int) -> None:
    verdicts = list(run(kind, count, first))
    assert [verdict.seed for verdict in verdicts] == list(range(first, first + count))
    bad = [one for one in verdicts if one.outcome not in GOOD and not known_fault(one)]
    assert not bad, "\n".join(map(str, bad))
    if kind != "kills":  # what is always refused at once tries nothing
        assert {one.outcome for one in verdicts} >= set(GOOD)
