"""Test exported pages in a headless browser (see `browsing`)."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from browsing import (
    ARM,
    SIDE,
    SceneCamera,
    check,
    configuration_at,
    errors,
    is_shade,
    places,
    requests,
    wait_for,
    wait_for_script,
)
from numpy.typing import NDArray
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.viewer import View, view

Array = NDArray[np.float64]


# Return times of the animation and of the clock, from two frames a second apart.
_ONE_SECOND = """const done = arguments[arguments.length - 1], read = [];
    const look = () => {
        const now = [animator.time, performance.now() / 1000];
        if (read.length === 0) read.push(now);
        if (now[1] - read[0][1] > 1.0) done([read[0], now]); else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);"""


@pytest.mark.slow
def test_the_exported_file_shows_the_motion(
    browser: webdriver.Chrome,
    scene: View,
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    tmp_path: Path,
) -> None:
    path = tmp_path / "scene.html"
    scene.to_html(path)
    requests(browser)
    browser.get(path.as_uri())
    wait_for_script(browser, "return document.body.dataset.ready === 'yes'")
    eye = SceneCamera(browser, scene, SIDE)

    slider = browser.find_element(By.ID, "slider")
    # Click near the end first, because a click on the knob, which starts near the beginning, has no effect.
    for share, other in ((0.95, plan.q[0]), (0.05, plan.q[-1])):
        offset = round((share - 0.5) * slider.size["width"])
        ActionChains(browser).move_to_element_with_offset(slider, offset, 0).click().perform()
        t = float(browser.execute_script("return document.getElementById('slider').value"))
        assert t == pytest.approx(12.0 * share, abs=0.6)
        assert f"t = {t:.2f} s" in browser.find_element(By.ID, "reading").text
        check(eye, planar, configuration_at(planar, plan, t), plan.target, other)

    # The arm's checkbox in the legend hides the arm; open the legend, which may have closed.
    browser.execute_script("document.getElementById('legend').open = true")
    browser.find_element(By.CSS_SELECTOR, "input[data-layer=robot]").click()
    link = places(planar, configuration_at(planar, plan, t))[1][1]
    wait_for(lambda: not is_shade(eye.colour(eye.picture(), link), ARM), lambda: "the arm is still there")

    assert errors(browser) == []
    asked = requests(browser)
    assert path.as_uri() in asked
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked), asked


@pytest.mark.slow
def test_the_exported_file_plays_in_true_time(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
    def rate(speed: float) -> float:
        path = tmp_path / f"{speed}.html"
        view(planar, plan, fps=5.0, speed=speed).to_html(path)
        browser.get(path.as_uri())
        wait_for_script(browser, "return document.body.dataset.ready === 'yes' && animator.time > 0.1")
        (t0, clock0), (t1, clock1) = browser.execute_async_script(_ONE_SECOND)
        return float((t1 - t0) % plan.duration / (clock1 - clock0))  # the animation restarts at its end

    assert rate(1.0) == pytest.approx(1.0, rel=0.1)
    assert rate(4.0) == pytest.approx(4.0, rel=0.1)


@pytest.mark.slow
def test_speed_view_and_background_can_be_chosen(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
    def choose(name: str, value: str) -> None:
        script = """const select = document.getElementById(arguments[0]);
            select.value = arguments[1];
            select.dispatchEvent(new Event("change"));
            return select.value"""
        assert browser.execute_script(script, name, value) == value

    path = tmp_path / "controls.html"
    made = view(planar, plan, fps=5.0, play=False)
    made.to_html(path)
    browser.get(path.as_uri())
    wait_for_script(browser, "return document.body.dataset.ready === 'yes'")
    shown = "return getComputedStyle(document.querySelector('.dg')).display"
    assert browser.execute_script(shown) == "none"  # Meshcat's own controls are hidden

    choose("speed", "8")
    assert browser.execute_script("return animator.mixer.timeScale") == 8.0

    for name, side in (("front", (1.0, 0.0, 0.0)), ("side", (0.0, -1.0, 0.0))):
        choose("camera", name)
        SceneCamera(browser, made, side)

    shown = "return getComputedStyle(document.getElementById('time')).color"
    dark = browser.execute_script(shown)
    browser.find_element(By.ID, "white").click()
    assert browser.execute_script(shown) != dark

    choose("camera", "base")
    browser.execute_script("seek(12.0)")
    root, turn = browser.execute_script(
        """const root = viewer.scene_tree.find(["ffsms"]).object;
        return [root.position.toArray(), root.quaternion.toArray()]"""
    )
    scene_root = pin.XYZQUATToSE3(np.array([*root, *turn]))
    centre = np.array(made._facts["centre"])
    stays = pin.SE3(np.eye(3), -centre) * pin.XYZQUATToSE3(plan.q[0, :7])
    base = scene_root * pin.XYZQUATToSE3(plan.q[-1, :7])
    np.testing.assert_allclose(base.homogeneous, stays.homogeneous, atol=1e-4)
    choose("camera", "free")
    root = browser.execute_script("return viewer.scene_tree.find(['ffsms']).object.position.toArray()")
    np.testing.assert_allclose(root, -centre, atol=1e-4)

    assert errors(browser) == []


@pytest.mark.slow
def test_every_view_shows_robot_and_client_beside_the_controls(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
    pose, twist = pin.SE3(np.eye(3), np.array([0.9, 0.9, 0.1])), np.array([0.02, 0.0, 0.01, 0.0, 0.0, 0.1])
    size = np.array([0.2, 0.3, 0.4])
    client = ffsms.Client(5.0, [1.0, 2.0, 2.5], pose, twist, [coal.Box(*size)])
    made = view(planar, plan, client=client, fps=1.0, play=False)
    path = tmp_path / "views.html"
    made.to_html(path)
    corners = np.array([*np.ndindex(2, 2, 2)]) - 0.5
    points = []
    for t, q in zip(plan.t[::100], plan.q[::100], strict=True):
        base, links = places(planar, q)
        body = client.pose(float(t))
        points += [base, *links, *(body.act(corner * size) for corner in corners)]
    for width, height in ((420, 800), (736, 480), (1280, 800)):
        window = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", window)
        browser.get(path.as_uri())
        wait_for_script(browser, "return document.body.dataset.ready === 'yes'")
        opened = browser.execute_script("return document.getElementById('legend').open")
        assert opened == (width > 900)  # an open legend covers nothing in a wide window
        corner = "return document.getElementById(arguments[0]).getBoundingClientRect()"
        bar, legend = (browser.execute_script(corner, name) for name in ("time", "legend"))
        assert 0.0 <= bar["left"] < bar["right"] <= width
        assert bar["bottom"] <= height
        left = legend["right"] if opened else 0.0
        for name in ("free", "front", "side", "top"):
            browser.execute_script("look(arguments[0])", name)
            eye = SceneCamera(browser, made, tuple(made._facts["cameras"][name]))
            at = np.array([eye.position(point) for point in points])
            assert (at > [left, 0.0]).all()
            assert (at < [width, bar["top"]]).all()
            filled = np.ptp(at, axis=0) / [width - left, bar["top"]]
            assert filled.max() > 0.6  # the scene fills most of the window
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert errors(browser) == []


@pytest.mark.slow
def test_meshes_of_an_arm_are_drawn(
    browser: webdriver.Chrome, tmp_path: Path, planar: ffsms.SpaceManipulator
) -> None:
    sms = ffsms.load("satellite_ur5")
    q0 = sms.configuration([0.3, -1.2, 1.2, 0.2, 0.5, 0.0])
    tip = sms.at(q0).end_effector_pose.translation
    plan = opt.plan(sms, q0, tip + np.array([0.0, 0.05, 0.0]), duration=2.0, dt=0.1, method="minimum-effort")
    path = tmp_path / "arm.html"
    view(sms, plan, fps=5.0).to_html(path)
    browser.get(path.as_uri())
    wait_for_script(browser, "return document.body.dataset.ready === 'yes'")
    count = """let count = 0;
        viewer.scene_tree.find(["ffsms", "robot"]).object.traverse((item) => {
            if (item.isMesh && item.geometry.attributes.position.count > 100) count += 1; });
        return count"""
    meshes = [item for item in sms.geometry("visual").geometryObjects if item.meshPath.endswith(".dae")]
    assert browser.execute_script(count) == len(meshes) > 4
    assert errors(browser) == []
