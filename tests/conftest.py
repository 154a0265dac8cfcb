"""Fixtures that several test files share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from kept_plans import kept_plan
from motions import Swing
from scenario_files import COARSE, write
from trees import Tree, packaged_planar, random_robot

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import ComputedTorque, SlidingModeController
from ffsms_pin.errors import FfsmsError
from ffsms_pin.opt import Trajectory
from ffsms_pin.simulation import Tracking, simulate

if TYPE_CHECKING:
    from selenium import webdriver

    from ffsms_pin.viewer import View


@pytest.fixture(scope="session")
def random_tree() -> Callable[..., Tree]:
    """Return the function `random_tree(seed, n, kinds=("revolute", "prismatic"))` of branched robots."""
    return random_robot


@pytest.fixture(scope="session")
def planar_tree() -> Tree:
    """Return the masses and lengths of the packaged planar robot, read from its file."""
    return packaged_planar()


@pytest.fixture(scope="session")
def planar() -> ffsms.SpaceManipulator:
    """Return the paper's planar system."""
    return ffsms.load("planar_3r")


@pytest.fixture(scope="session")
def panda() -> ffsms.SpaceManipulator:
    """Return an arm of seven joints on the default satellite; some modules override this fixture."""
    return ffsms.load("satellite_panda")


@pytest.fixture(scope="session")
def bent(panda: ffsms.SpaceManipulator) -> FloatArray:
    """Return a configuration of `panda` with a bent elbow, away from singular postures."""
    return panda.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])


@pytest.fixture(scope="session")
def swing(planar: ffsms.SpaceManipulator) -> Swing:
    """Return a joint motion of the planar system of 2 s."""
    return Swing(planar)


@pytest.fixture(scope="session")
def swung(planar: ffsms.SpaceManipulator, swing: Swing) -> Tracking:
    """Return the recording of `swing` under the paper's control law."""
    return simulate(planar, swing, SlidingModeController(planar))


@pytest.fixture(scope="session")
def plan(planar: ffsms.SpaceManipulator) -> Trajectory:
    """Return a plan of the planar system of 12 s; some modules override this fixture."""
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.plan(planar, q0, [0.45, 0.75, 0.0], duration=12.0, dt=0.05)


@pytest.fixture(scope="session")
def tracking(planar: ffsms.SpaceManipulator, plan: Trajectory) -> Tracking:
    """Return the recording of `plan` under the paper's control law; some modules override this fixture."""
    return simulate(planar, plan, SlidingModeController(planar), dt=0.01)


@pytest.fixture(scope="session")
def law(planar: ffsms.SpaceManipulator) -> ComputedTorque:
    """Return a control law without internal state for the planar system."""
    return ComputedTorque(planar, adaptive=False)


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    """Write the scenario COARSE to quick.toml."""
    return write(tmp_path, COARSE, "quick.toml")


@pytest.fixture
def kept_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let scenarios with the same problem share a plan, see `kept_plan`."""
    monkeypatch.setattr("ffsms_pin.scenarios.closed_loop.plan_problem", kept_plan)


@pytest.fixture(scope="session")
def refused() -> Callable[..., FfsmsError]:
    """Return `refused(call, kind, *fragments)`, which checks that a call raises a one-line error."""

    def check(call: Callable[[], Any], kind: type[FfsmsError], *fragments: str) -> FfsmsError:
        with pytest.raises(FfsmsError) as caught:
            call()
        assert type(caught.value) is kind
        line = str(caught.value)
        assert "\n" not in line
        assert line.strip()
        for fragment in fragments:
            assert fragment in line
        # The traceback shows no exception of another library.
        assert caught.value.__suppress_context__ or caught.value.__context__ is None
        return caught.value

    return check


@pytest.fixture(scope="module")
def scene(planar: ffsms.SpaceManipulator, plan: Trajectory) -> View:
    """Return `plan` in the viewer at 20 frames per second; some modules override this fixture."""
    from ffsms_pin.viewer import view

    return view(planar, plan, show=("robot", "target"), fps=20.0)


@pytest.fixture(scope="session")
def started_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    """Start headless Chromium once per session."""
    from browsing import chromium

    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def browser(started_browser: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    """Return the browser, and stop its drawing after the test, because a playing scene uses a whole core."""
    yield started_browser
    started_browser.get("about:blank")


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a random number generator with a fixed seed."""
    return np.random.default_rng(20250705)
