"""Laws in several threads: the same torques as in one."""

from __future__ import annotations

import copy
import pickle
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from motions import Swing

import ffsms_pin as ffsms
from ffsms_pin.control import LAWS, Admittance
from ffsms_pin.simulation import JointFriction, WristSensor, simulate


@pytest.fixture
def frequent_switches() -> Iterator[None]:
    """A switch interval of a microsecond, so that threads take turns within a step."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("frequent_switches")
@pytest.mark.parametrize("name", LAWS)
def test_a_law_serves_runs_in_several_threads(planar: ffsms.SpaceManipulator, name: str) -> None:
    options: dict[str, Any] = {"friction": JointFriction(0.02, 0.01), "wrist": WristSensor(0.1)}
    law = LAWS[name](planar)
    swings = [Swing(planar, displacement=(0.02 * i, -0.01 * i, 0.02), duration=0.2) for i in range(1, 5)]
    alone = [simulate(planar, swing, law, guards=None, **options) for swing in swings]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda swing: simulate(planar, swing, law, guards=None, **options), swings))
    for single, other in zip(alone, together, strict=True):
        assert single.tau.tobytes() == other.tau.tobytes()
        assert single.q.tobytes() == other.q.tobytes()


def test_a_thread_and_a_copy_have_a_state_of_their_own(planar: ffsms.SpaceManipulator) -> None:
    q, still = planar.configuration([0.1, 0.2, 0.3]), np.zeros(3)
    state: tuple[Any, ...] = (q, np.zeros(9), np.array([0.1, 0.2, 0.2]), still, still)
    law = Admittance(planar, torque_limit=np.inf)
    fresh = law.torque(*state)
    law.observe_wrench(0.0, np.array([0.1, 0.1, 0.0, 0.0, 0.0, 0.01]))
    copies = [copy.deepcopy(law), pickle.loads(pickle.dumps(law))]
    pushed = law.torque(*state)
    assert (pushed != fresh).any()
    for again in copies:
        assert (again.torque(*state) == pushed).all()
    with ThreadPoolExecutor(1) as pool:  # a new thread starts from the initial state of the law
        assert (pool.submit(law.torque, *state).result() == fresh).all()
