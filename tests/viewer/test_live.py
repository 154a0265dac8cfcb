"""The live page: it shows, it changes nothing, and its failures are no failures of the simulation."""

from __future__ import annotations

import socket
import struct
import threading
import time
import urllib.request
import warnings
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from numpy.typing import NDArray
from pages import connected

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import FfsmsWarning, ViewerError
from ffsms_pin.simulation.interfaces import Instant
from ffsms_pin.viewer import LiveView, view

Array = NDArray[np.float64]


pytestmark = pytest.mark.usefixtures("own_ports")


@pytest.fixture(scope="module")
def plan(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.plan(planar, q0, [0.45, 0.75, 0.0], duration=6.0, dt=0.05)


@pytest.fixture(scope="module")
def alone(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> ffsms.Tracking:
    return ffsms.simulate(planar, plan, ffsms.SlidingModeController(planar), dt=0.05)


@pytest.fixture
def live(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> LiveView:
    return LiveView(planar, plan.q[0], plan.target, speed=None, fps=1e4, browser=False)


def run(
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    live: LiveView,
    halfway: Callable[[], None] = lambda: None,
) -> ffsms.Tracking:
    """A watched simulation, with something that happens in its middle."""
    seen: list[float] = []

    def progress(share: float) -> None:
        if share >= 0.5 and not seen:
            seen.append(share)
            halfway()

    controller = ffsms.SlidingModeController(planar)
    tracking = ffsms.simulate(planar, live.watch(plan), controller, dt=0.05, progress=progress)
    assert seen
    return tracking


def test_the_live_page_is_served_and_stops(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> None:
    before = set(threading.enumerate())  # threads of earlier tests may end meanwhile
    scene = view(planar, plan, fps=5.0)
    url = scene.open(browser=False)
    assert scene.open(browser=False) == url
    with urllib.request.urlopen(url, timeout=20) as answer:
        assert b"meshcat" in answer.read().lower()
    assert len(set(threading.enumerate()) - before) == 1
    scene.close()
    assert not set(threading.enumerate()) - before
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url, timeout=20)
    scene.close()  # a second time does nothing


def test_a_view_opens_for_other_machines_when_asked(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    with view(planar, plan, fps=1.0) as scene:
        assert scene.open(browser=False, host="127.0.0.1").startswith("http://127.0.0.1:")
    with LiveView(planar, plan.q[0], browser=False, host="localhost") as live:
        assert live.url.startswith("http://localhost:")


def test_a_simulation_is_watched_without_being_changed(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory, live: LiveView, alone: ffsms.Tracking
) -> None:
    seen: list[float] = []
    with live:
        show = live.show

        def noted(t: float, q: Array, v: Array) -> None:
            seen.append(t)
            show(t, q, v)

        live.show = noted  # type: ignore[method-assign]
        watched = run(planar, plan, live)
    np.testing.assert_array_equal(watched.q, alone.q)
    assert len(seen) > 50
    assert seen == sorted(seen)


def test_a_server_that_ends_costs_one_warning(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory, live: LiveView, alone: ffsms.Tracking
) -> None:
    with live, pytest.warns(FfsmsWarning, match="server has ended") as said:
        tracking = run(planar, plan, live, live._server.close)
    assert len(said) == 1
    assert "\n" not in str(said[0].message)
    np.testing.assert_array_equal(tracking.q, alone.q)


def test_a_drawing_that_fails_costs_one_warning(
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    live: LiveView,
    alone: ffsms.Tracking,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("no more colours")

    with live, pytest.warns(FfsmsWarning, match="no more colours") as said:
        tracking = run(planar, plan, live, lambda: monkeypatch.setattr(live, "_draw", broken))
    assert len(said) == 1
    np.testing.assert_array_equal(tracking.q, alone.q)


def test_a_failed_page_holds_nothing_up(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory, alone: ffsms.Tracking
) -> None:
    """At a thousandth of true time, the run would take more than an hour."""
    with LiveView(planar, plan.q[0], speed=1e-3, browser=False) as live:
        live._server.close()
        with pytest.warns(FfsmsWarning):
            live.show(0.0, plan.q[0], np.zeros(planar.nv))
        started = time.monotonic()
        np.testing.assert_array_equal(run(planar, plan, live).q, alone.q)
        assert time.monotonic() - started < 20.0


def test_closed_sockets_and_vanished_browsers_are_no_news(
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    live: LiveView,
    alone: ffsms.Tracking,
    caplog: pytest.LogCaptureFixture,
) -> None:
    pages = [connected(live.url) for _ in range(5)]

    def vanish() -> None:
        for k, page in enumerate(pages):
            if k % 2:  # without a farewell
                page.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            page.close()
        for plug in live._server._sockets:
            plug.close()

    with live, warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(run(planar, plan, live, vanish).q, alone.q)
    assert caplog.records == []


def test_pages_that_read_nothing_stall_nothing(
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    live: LiveView,
    alone: ffsms.Tracking,
    caplog: pytest.LogCaptureFixture,
) -> None:
    with live:
        stuck = [connected(live.url) for _ in range(3)]
        started = time.monotonic()
        tracking = run(planar, plan, live)
        kept = len(live._server.scene._latest)
        for _ in range(20):
            for t, q, v in zip(tracking.t, tracking.q, tracking.v, strict=True):
                live.show(float(t), q, v)
        assert time.monotonic() - started < 60.0
        assert len(live._server.scene._latest) == kept  # no queue grows
        started = time.monotonic()
        live.close()
        assert time.monotonic() - started < 2.0
        for page in stuck:
            page.close()
    assert caplog.records == []
    np.testing.assert_array_equal(tracking.q, alone.q)


def test_without_a_free_port_the_view_says_so(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        monkeypatch.setattr("ffsms_pin.viewer.server._PORTS", range(number, number + 1))
        with pytest.raises(ViewerError, match="no free port"):
            view(planar, plan, fps=1.0).open(browser=False)


def test_a_client_wheels_and_what_touches_are_shown(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    """The client by itself until a supervised run says where it is; wheels with the base."""
    robot = planar.with_actuators(wheels=ffsms.ReactionWheels(np.eye(3), 0.01, 0.1, 1.0))
    twist = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    client = ffsms.Client(10.0, np.eye(3), pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.0])), twist)

    def placed(name: str) -> Array:
        _, packed = shown._stage.scene._latest["set_transform", f"/ffsms/{name}", ""]
        return np.array(umsgpack.unpackb(packed)["matrix"]).reshape(4, 4).T

    q, v = plan.q[60], plan.v[60]
    with LiveView(robot, plan.q[0], plan.target, client=client, browser=False) as shown:
        shown.show(3.0, q, v)
        np.testing.assert_allclose(placed("client")[:3, 3], [2.3, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(placed("wheels"), pin.XYZQUATToSE3(q[:7]).homogeneous, atol=1e-12)
        assert placed("contact force")[2, 2] < 1e-5
        supervisor = shown.supervise()
        pushed = pin.SE3(np.eye(3), np.array([2.5, 0.1, 0.0]))
        for force in (0.0, 3.0, 1.0):
            wrench = np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])
            assert supervisor.decide(Instant(3.1, q, v, pushed, twist, wrench, np.zeros(3))) == ()
        shown.show(3.1, q, v)
        np.testing.assert_allclose(placed("client"), pushed.homogeneous, atol=1e-12)
        assert placed("contact force")[2, 2] > 0.1  # the largest, not the last
        shown.show(3.2, q, v)
        assert placed("contact force")[2, 2] < 1e-5
        assert supervisor.model is robot
