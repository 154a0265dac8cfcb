"""Laws in several threads: the same torques as in one, or a word."""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from motions import Swing

import ffsms_pin as ffsms
from ffsms_pin.control import LAWS, SuperTwisting
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.simulation import JointFriction, WristSensor, simulate

Refused = Callable[..., FfsmsError]


@pytest.fixture
def hasty() -> Iterator[None]:
    """Threads that take turns every few microseconds."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize("name", LAWS)
def test_one_law_serves_runs_in_several_threads(planar: ffsms.SpaceManipulator, name: str) -> None:
    options: dict[str, Any] = {"friction": JointFriction(0.02, 0.01), "wrist": WristSensor(0.1)}
    law = LAWS[name](planar)
    swings = [Swing(planar, way=(0.02 * i, -0.01 * i, 0.02), duration=0.2) for i in range(1, 5)]
    alone = [simulate(planar, swing, law, **options) for swing in swings]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda swing: simulate(planar, swing, law, **options), swings))
    for one, other in zip(alone, together, strict=True):
        assert one.tau.tobytes() == other.tau.tobytes()
        assert one.q.tobytes() == other.q.tobytes()


def test_a_thread_that_would_go_on_with_a_memory_of_another_is_refused(
    refused: Refused, planar: ffsms.SpaceManipulator
) -> None:
    law = SuperTwisting(planar)
    q, still = planar.configuration([0.1, 0.2, 0.3]), np.zeros(3)
    state: tuple[Any, ...] = (q, np.zeros(9), np.array([0.1, 0.2, 0.2]), still, still)
    first = law.torque(*state)
    second = law.torque(*state)
    assert (first != second).any()  # it remembers

    def elsewhere(work: Callable[[], Any]) -> Any:
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(work).result()

    def begin() -> Any:
        law.reset()
        return law.torque(*state)

    refused(lambda: elsewhere(lambda: law.torque(*state)), InvalidValue, "reset()", "thread")
    assert (elsewhere(begin) == first).all()
    assert (law.w != 0.0).any()  # what this thread remembers is still there


def test_a_copy_remembers(planar: ffsms.SpaceManipulator) -> None:
    law = SuperTwisting(planar)
    q, still = planar.configuration([0.1, 0.2, 0.3]), np.zeros(3)
    state: tuple[Any, ...] = (q, np.zeros(9), np.array([0.1, 0.2, 0.2]), still, still)
    law.torque(*state)
    for again in (copy.deepcopy(law), pickle.loads(pickle.dumps(law))):
        assert (again.w == law.w).all()
        assert again.dt == law.dt
    expected = law.torque(*state)
    assert (again.torque(*state) == expected).all()
