"""Test client, obstacles and events in the scene of a capture."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from browsing import SIDE, SceneCamera, errors, places, wait_for_script
from exported import ExportedPage
from motions import Swing
from selenium import webdriver
from selenium.webdriver.common.by import By

import ffsms_pin as ffsms
from ffsms_pin import capture, opt, simulation
from ffsms_pin.control import PD, ComputedTorque
from ffsms_pin.errors import InvalidValue
from ffsms_pin.viewer import view

GRASP = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))
BOX = [0.5, 0.6, 0.7]


def _flight(**options: object) -> capture.Flight:
    """Simulate the approach to a rotating client that the end effector can reach in a few seconds."""
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8])
    end = sms.configuration([0.1, -0.4, 0.1, -2.0, 0.0, 3.1, 0.9])
    pose = sms.at(end).end_effector_pose * GRASP.inverse()
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, [0.0, 0.0, 0.0, 0.0, 0.02, 0.0], [coal.Box(*BOX)])
    away = opt.Obstacle.sphere(0.1, at=[3.0, 3.0, 3.0])
    return capture.fly(
        sms,
        q0,
        opt.Meet(client, GRASP, standoff=0.05),
        6.0,
        control=capture.Control(partial(ComputedTorque, K_p=100.0, K_d=20.0, adaptive=False), dt=0.01),
        planning=capture.Planning(dt=0.05, obstacles=[opt.Obstacle.box(BOX, on=client), away]),
        procedure=capture.Procedure(attempts=1, retreat=0.1, after=1.0),
        **options,  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def latched() -> capture.Flight:
    return _flight(grip=capture.Grip(time=0.3))


def test_a_flight_is_shown_with_client_obstacles_and_events(latched: capture.Flight) -> None:
    assert latched.outcome == "latched"
    page = ExportedPage(ffsms.view(latched, fps=2.0).html())
    layers = {layer["name"]: layer["shown"] for layer in page.facts["layers"]}
    assert layers["client"]
    assert layers["obstacles"]
    assert layers["events"]
    assert layers["planned_path"]
    assert [mark["name"] for mark in page.facts["marks"]] == ["hold point", "contact", "latched", "rest"]
    times = {name: time for time, name, _ in latched.states}
    for mark, name in zip(page.facts["marks"], ("closing", "contact", "braking", "rest"), strict=True):
        assert mark["t"] == pytest.approx(times[name], abs=1e-4)
    assert page.facts["marks"][1]["reason"].startswith("inside the envelope")
    # The ball of the contact is at the end effector's position at that time.
    (node,) = [item for item in page.of("set_transform") if item["path"] == "/ffsms/events/1"]
    row = int(np.searchsorted(latched.tracking.t, times["contact"] - 1e-9))
    tip = latched.plant.at(latched.tracking.q[row]).end_effector_pose.translation
    np.testing.assert_allclose(np.array(node["matrix"]).reshape(4, 4).T[:3, 3], tip, atol=1e-6)
    # The latched client moves with the end effector; its last position is that of the recording.
    moved = page.track("client", "position")[1]
    np.testing.assert_allclose(moved[-1], latched.tracking.client_pose[-1, :3], atol=1e-5)


def test_the_distance_is_to_the_moving_grasp_until_it_is_latched(latched: capture.Flight) -> None:
    page = ExportedPage(ffsms.view(latched, fps=10.0).html())
    (distance,) = [item for item in page.facts["readings"] if item["label"] == "to grasp"]
    flown, times = latched.tracking, {name: time for time, name, _ in latched.states}
    for t, value in zip(page.facts["t"], distance["values"], strict=True):
        if t > times["braking"] - 1e-6:
            assert value is None
            continue
        row = int(np.argmin(np.abs(flown.t - t)))
        tip = latched.plant.at(flown.q[row]).end_effector_pose.translation
        grasp = pin.XYZQUATToSE3(flown.client_pose[row]).act(GRASP.translation)
        assert value == pytest.approx(1e3 * np.linalg.norm(grasp - tip), abs=1e-3)
    assert distance["without"] == "latched"
    # The grapple ring is drawn because the client has no other shape at the grasp.
    assert "/ffsms/client/grapple ring" in {command["path"] for command in page.of("set_object")}
    place = page.track("target", "position")[1]
    assert np.ptp(place, axis=0).max() > 0.01  # it turns with the client


def test_a_grasp_needs_a_client(planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking) -> None:
    with pytest.raises(InvalidValue, match=r"grasp .*requires client="):
        view(planar, tracking, grasp=[0.0, 0.0, -0.4])
    client = ffsms.Client(1.0, [1.0, 1.0, 1.0])
    with pytest.raises(InvalidValue, match="grasp must have shape"):
        view(planar, tracking, client=client, grasp=[0.0, 0.4])


@pytest.mark.slow
def test_a_client_that_is_not_caught_has_the_marks_of_retreat_and_stop() -> None:
    flight = _flight(envelope=capture.Envelope(distance=1e-9))
    assert not flight.latched
    page = ExportedPage(ffsms.view(flight.plant, flight, fps=2.0).html())
    names = [mark["name"] for mark in page.facts["marks"]]
    assert "stop" in names
    assert "latched" not in names
    (stop,) = [mark for mark in page.facts["marks"] if mark["name"] == "stop"]
    (event,) = [mark for mark in page.facts["marks"] if mark["name"] == "rest"]
    assert stop["colour"] != event["colour"]
    assert "given up after 1 attempt" in stop["reason"]


def test_the_stop_by_a_guard_is_marked(planar: ffsms.SpaceManipulator) -> None:
    guards = simulation.Guards(joint_error=1e-6)
    tracking = ffsms.simulate(
        planar, Swing(planar), PD(planar), dt=0.01, conditions=simulation.Conditions(guards=guards)
    )
    assert tracking.stopped
    (mark,) = ExportedPage(view(planar, tracking).html()).facts["marks"]
    assert mark["name"] == "stop"
    assert mark["t"] == pytest.approx(tracking.stop_time, abs=0.02)
    assert mark["reason"] == tracking.stopped


def test_arguments_that_are_no_results_are_refused(planar: ffsms.SpaceManipulator) -> None:
    with pytest.raises(InvalidValue, match=r"result must be a Trajectory, a Tracking or a capture\.Flight"):
        view(planar)
    with pytest.raises(InvalidValue, match="sms must be a SpaceManipulator"):
        view("planar_3r", "plan.npz")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_click_on_a_mark_goes_to_its_event(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking, tmp_path: Path
) -> None:
    phases = [simulation.Phase(3.0, "closing", "go"), simulation.Phase(6.0, "braking", "given up")]
    view(planar, tracking, events=phases, fps=5.0, play=False).to_html(tmp_path / "marks.html")
    browser.get((tmp_path / "marks.html").as_uri())
    wait_for_script(browser, "return document.body.dataset.ready === 'yes'")
    hold, stop = browser.find_elements(By.CSS_SELECTOR, "#track .mark")
    assert hold.get_attribute("title") == "3.00 s: hold point (go)"
    assert stop.get_attribute("title") == "6.00 s: stop (given up)"
    slider = browser.find_element(By.ID, "slider")
    left = slider.location["x"] + 8.0 + (slider.size["width"] - 16.0) * 0.5
    assert stop.location["x"] + 2.0 == pytest.approx(left, abs=1.5)
    stop.click()
    assert float(browser.execute_script("return document.getElementById('slider').value")) == 6.0
    reading = browser.find_element(By.ID, "reading").text
    assert "t = 6.00 s" in reading
    assert "stop" in reading
    assert errors(browser) == []


@pytest.mark.slow
def test_keys_move_the_time_trails_grow_and_names_are_shown(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking, tmp_path: Path
) -> None:
    def key(name: str) -> float:
        script = (
            "document.body.dispatchEvent(new KeyboardEvent('keydown', {key: arguments[0], bubbles: true}));"
        )
        return float(browser.execute_script(script + "return animator.time", name))

    made = view(planar, tracking, fps=5.0, play=False)
    made.to_html(tmp_path / "keys.html")
    browser.get((tmp_path / "keys.html").as_uri())
    wait_for_script(browser, "return document.body.dataset.ready === 'yes'")
    count = """return viewer.scene_tree.find(["ffsms", "tracked path", "<object>"])
        .object.geometry.drawRange.count"""
    assert key("End") == pytest.approx(12.0)
    assert browser.execute_script(count) in (None, float("inf"))  # the whole trail
    assert key("ArrowLeft") == pytest.approx(11.88)
    assert key("Home") == 0.0
    assert browser.execute_script(count) == 0
    assert key("ArrowRight") == pytest.approx(0.12)
    key(" ")
    assert browser.execute_script("return animator.playing")
    key(" ")
    assert not browser.execute_script("return animator.playing")
    eye = SceneCamera(browser, made, SIDE)
    key("Home")
    base, links = places(planar, tracking.q[0])
    title = "viewer.render(); return titleAt(new MeshCat.THREE.Raycaster(), arguments[0], arguments[1])"
    for place, name in ((links[0], "link_1"), (links[2], "link_3")):
        assert browser.execute_script(title, *eye.pixel(place)) == name
    assert browser.execute_script(title, *eye.pixel(base)) == "base"
    assert browser.execute_script(title, 5, 5) == ""
    assert errors(browser) == []
