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
from trees import Tree, grown, packaged_planar

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
    """Builder `random_tree(seed, n, kinds=("revolute", "prismatic"))` of branched robots in space."""
    return grown


@pytest.fixture(scope="session")
def planar_tree() -> Tree:
    """The packaged planar robot, read from its file in plain numbers."""
    return packaged_planar()


@pytest.fixture(scope="session")
def planar() -> ffsms.SpaceManipulator:
    """The paper's planar system."""
    return ffsms.load("planar_3r")


@pytest.fixture(scope="session")
def panda() -> ffsms.SpaceManipulator:
    """An arm of seven joints on the default satellite; some modules have another one by this name."""
    return ffsms.load("satellite_panda")


@pytest.fixture(scope="session")
def bent(panda: ffsms.SpaceManipulator) -> FloatArray:
    """A configuration of it with a bent elbow, away from singular postures."""
    return panda.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])


@pytest.fixture(scope="session")
def swing(planar: ffsms.SpaceManipulator) -> Swing:
    """A joint motion of the planar system, two seconds long."""
    return Swing(planar)


@pytest.fixture(scope="session")
def swung(planar: ffsms.SpaceManipulator, swing: Swing) -> Tracking:
    """The closed loop along it, under the paper's law."""
    return simulate(planar, swing, SlidingModeController(planar))


@pytest.fixture(scope="session")
def plan(planar: ffsms.SpaceManipulator) -> Trajectory:
    """A plan of the planar system, twelve seconds long; some modules have another one by this name."""
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.plan(planar, q0, [0.45, 0.75, 0.0], duration=12.0, dt=0.05)


@pytest.fixture(scope="session")
def tracking(planar: ffsms.SpaceManipulator, plan: Trajectory) -> Tracking:
    """The plan, followed under the paper's law; likewise."""
    return simulate(planar, plan, SlidingModeController(planar), dt=0.01)


@pytest.fixture(scope="session")
def law(planar: ffsms.SpaceManipulator) -> ComputedTorque:
    """A law for the planar system, without a memory."""
    return ComputedTorque(planar, adaptive=False)


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    """The scenario COARSE as the file quick.toml."""
    return write(tmp_path, COARSE, "quick.toml")


@pytest.fixture
def kept_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenarios that ask for the same plan share it, see `kept_plan`."""
    monkeypatch.setattr("ffsms_pin.scenarios.closed_loop.plan_problem", kept_plan)


@pytest.fixture(scope="session")
def refused() -> Callable[..., FfsmsError]:
    """Checker `refused(call, kind, *words)`: the error is of that class and one line."""

    def check(call: Callable[[], Any], kind: type[FfsmsError], *words: str) -> FfsmsError:
        with pytest.raises(FfsmsError) as caught:
            call()
        assert type(caught.value) is kind
        line = str(caught.value)
        assert "\n" not in line
        assert line.strip()
        for word in words:
            assert word in line
        # No other library's exception shows through either.
        assert caught.value.__suppress_context__ or caught.value.__context__ is None
        return caught.value

    return check


@pytest.fixture(scope="module")
def scene(planar: ffsms.SpaceManipulator, plan: Trajectory) -> View:
    """The plan in the viewer, twenty frames a second; some modules have another one by this name."""
    from ffsms_pin.viewer import view

    return view(planar, plan, show=("robot", "target"), fps=20.0)


@pytest.fixture(scope="session")
def started_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    """Headless Chromium, started once."""
    from browsing import chromium

    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def browser(started_browser: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    """The browser, which draws nothing after the test: a scene that plays on takes a whole core."""
    yield started_browser
    started_browser.get("about:blank")


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run."""
    return np.random.default_rng(20250705)
