"""What a real browser shows: headless Chromium opens the exported file and the live page.

Needs Debian's chromium and chromium-driver. Where they are missing, the tests are skipped and say so in the
summary; under CI that is a failure.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.viewer import LiveView, View, view
from ffsms_pin.viewer.frames import surroundings

Array = NDArray[np.float64]

_PATIENCE = 60.0  # [s]
_FLAGS = (
    "--headless=new",
    "--no-sandbox",  # CI runs as root
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",  # no graphics card
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--force-device-scale-factor=1",
    "--hide-scrollbars",
    "--window-size=1000,760",
)
# Shades of the packaged planar robot's materials, as shares of their largest component.
_BODY, _ARM = np.array([0.80, 0.78, 0.72]) / 0.80, np.array([0.20, 0.42, 0.63]) / 0.63
_TARGET = np.array([0xD5, 0x5E, 0x00])


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next((found for name in names if (found := shutil.which(name))), None)
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        missing = "the browser tests were not run: they need chromium and chromium-driver"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*_FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    chrome.get("about:blank")  # the browser's own first page, and what it asks for, end here
    yield chrome
    chrome.quit()


@pytest.fixture(scope="module")
def plan(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.plan(planar, q0, [0.45, 0.75, 0.0], duration=12.0, dt=0.05)


@pytest.fixture(scope="module")
def scene(planar: ffsms.SpaceManipulator, plan: opt.Trajectory) -> Iterator[View]:
    with view(planar, plan, show=("robot", "target"), fps=20.0) as made:
        yield made


_TWO_FRAMES = """const done = arguments[arguments.length - 1];
    const next = (then) => requestAnimationFrame(then);
    next(() => { viewer.set_dirty(); next(() => next(done)); });"""


# The film's time and the clock's, read in one frame each, a second apart.
_ONE_SECOND = """const done = arguments[arguments.length - 1], read = [];
    const look = () => {
        const now = [animator.time, performance.now() / 1000];
        if (read.length === 0) read.push(now);
        if (now[1] - read[0][1] > 1.0) done([read[0], now]); else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);"""


class Eye:
    """Screenshots, and where in them a place of the scene must be.

    The projection is worked out here from where `view` says the camera is: 1.3 radii from the centre of what
    is shown, on the given side, z up, with Meshcat's 75 degrees from top to bottom.
    """

    def __init__(self, browser: webdriver.Chrome, scene: View, side: tuple[float, float, float]) -> None:
        centre, radius = surroundings(scene._frames)
        away = np.array(side) / np.linalg.norm(side)
        self._browser, self._camera = browser, centre + 1.3 * radius * away
        right = np.cross(-away, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self._axes = np.array([right, np.cross(right, -away), -away])
        self._width, self._height = browser.execute_script("return [innerWidth, innerHeight]")

    def pixel(self, place: Array) -> tuple[int, int]:
        x, y, depth = self._axes @ (place - self._camera)
        scale = 0.5 * self._height / np.tan(np.radians(75.0) / 2.0)
        return round(0.5 * self._width + scale * x / depth), round(0.5 * self._height - scale * y / depth)

    def picture(self) -> Array:
        """What is on the screen (height, width, 3), 0 to 255."""
        self._browser.execute_async_script(_TWO_FRAMES)  # what was changed just now is drawn in the next
        with Image.open(io.BytesIO(self._browser.get_screenshot_as_png())) as image:
            return np.asarray(image.convert("RGB"), dtype=np.float64)

    def colour(self, picture: Array, place: Array) -> Array:
        """Mean colour of 3 by 3 pixels at a place."""
        column, row = self.pixel(place)
        patch = picture[row - 1 : row + 2, column - 1 : column + 2]
        assert patch.shape == (3, 3, 3), f"{place} is outside of the picture, at {column}, {row}"
        return np.asarray(patch.reshape(9, 3).mean(axis=0))


def _is_shade(colour: Array, of: Array) -> bool:
    """Whether a colour is the material's, in more or less light."""
    return bool(np.abs(colour / colour.max() - of).max() < 0.12)


def _places(sms: ffsms.SpaceManipulator, q: Array) -> tuple[Array, list[Array]]:
    """A point on the top of the base, and the middle of each link."""
    data = sms.model.createData()
    pin.forwardKinematics(sms.model, data, q)
    assert sms.base_size is not None
    top = data.oMi[1].act(np.array([-0.1, 0.12, 0.5 * sms.base_size[2]]))
    return np.array(top), [np.array(data.oMi[j].act(np.array([0.15, 0.0, 0.0]))) for j in (2, 3, 4)]


def _check(eye: Eye, sms: ffsms.SpaceManipulator, q: Array, target: Array, others: Array) -> None:
    """Base, arm and target are where they belong, and the arm is not where `others` (nq,) puts it."""
    base, links = _places(sms, q)
    elsewhere = _places(sms, others)[1][2]

    def wrong() -> list[str]:
        picture = eye.picture()
        found = [f"base {eye.colour(picture, base)}"] * (not _is_shade(eye.colour(picture, base), _BODY))
        found += [
            f"link at {link} {eye.colour(picture, link)}"
            for link in links
            if not _is_shade(eye.colour(picture, link), _ARM)
        ]
        if np.abs(eye.colour(picture, target) - _TARGET).max() > 12.0:
            found.append(f"target {eye.colour(picture, target)}")
        if _is_shade(eye.colour(picture, elsewhere), _ARM):
            found.append(f"an arm at {elsewhere}")
        return found

    _soon(lambda: not wrong(), wrong)


def _soon(holds: Callable[[], bool], explain: Callable[[], object]) -> None:
    """Wait for what the page needs a moment for: without a graphics card it is slow."""
    started = time.monotonic()
    while not holds():
        if time.monotonic() - started > 15.0:
            pytest.fail(str(explain()))
        time.sleep(0.2)


def _until(browser: webdriver.Chrome, script: str) -> None:
    started = time.monotonic()
    while not browser.execute_script(script):
        if time.monotonic() - started > _PATIENCE:
            pytest.fail(f"the page never came to: {script}; it says {_errors(browser)}")
        time.sleep(0.05)


def _requests(browser: webdriver.Chrome) -> list[str]:
    """Addresses that were asked for since the last call."""
    entries: list[Any] = browser.get_log("performance")  # type: ignore[no-untyped-call]
    messages = [json.loads(entry["message"])["message"] for entry in entries]
    return [
        str(item["params"]["request"]["url"])
        for item in messages
        if item["method"] == "Network.requestWillBeSent"
    ]


def _errors(browser: webdriver.Chrome) -> list[str]:
    entries: list[Any] = browser.get_log("browser")  # type: ignore[no-untyped-call]
    return [str(entry["message"]) for entry in entries if entry["level"] == "SEVERE"]


def _at(sms: ffsms.SpaceManipulator, trajectory: opt.Trajectory, t: float) -> Array:
    """Configuration at a time between two nodes."""
    k = min(int(t / trajectory.dt), len(trajectory.t) - 2)
    share = t / trajectory.dt - k
    return np.array(pin.interpolate(sms.model, trajectory.q[k], trajectory.q[k + 1], share))


SIDE = (-0.12, -0.75, 1.5)  # a planar motion is seen from above


def test_the_exported_file_shows_the_motion(
    browser: webdriver.Chrome,
    scene: View,
    planar: ffsms.SpaceManipulator,
    plan: opt.Trajectory,
    tmp_path: Path,
) -> None:
    path = tmp_path / "scene.html"
    scene.to_html(path)
    _requests(browser)
    browser.get(path.as_uri())
    _until(browser, "return document.body.dataset.ready === 'yes'")
    eye = Eye(browser, scene, SIDE)

    slider = browser.find_element(By.ID, "slider")
    # The end first: a click on the knob itself, which starts near the beginning, moves and pauses nothing.
    for share, other in ((0.95, plan.q[0]), (0.05, plan.q[-1])):
        offset = round((share - 0.5) * slider.size["width"])
        ActionChains(browser).move_to_element_with_offset(slider, offset, 0).click().perform()
        t = float(browser.execute_script("return document.getElementById('slider').value"))
        assert t == pytest.approx(12.0 * share, abs=0.6)
        assert f"t = {t:.2f} s" in browser.find_element(By.ID, "reading").text
        _check(eye, planar, _at(planar, plan, t), plan.target, other)

    # The arm's box in the legend takes the arm away; the legend may have folded itself meanwhile.
    browser.execute_script("document.getElementById('legend').open = true")
    browser.find_element(By.CSS_SELECTOR, "input[data-layer=robot]").click()
    link = _places(planar, _at(planar, plan, t))[1][1]
    _soon(lambda: not _is_shade(eye.colour(eye.picture(), link), _ARM), lambda: "the arm is still there")

    assert _errors(browser) == []
    asked = _requests(browser)
    assert path.as_uri() in asked
    assert all(url.startswith(("file:", "data:", "blob:")) for url in asked), asked


def test_the_exported_file_plays_in_true_time(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory, tmp_path: Path
) -> None:
    def rate(speed: float) -> float:
        path = tmp_path / f"{speed}.html"
        view(planar, plan, fps=5.0, speed=speed).to_html(path)
        browser.get(path.as_uri())
        _until(browser, "return document.body.dataset.ready === 'yes' && animator.time > 0.1")
        (t0, clock0), (t1, clock1) = browser.execute_async_script(_ONE_SECOND)
        return float((t1 - t0) % plan.duration / (clock1 - clock0))  # it starts anew at its end

    assert rate(1.0) == pytest.approx(1.0, rel=0.1)
    assert rate(4.0) == pytest.approx(4.0, rel=0.1)


def test_speed_and_view_can_be_chosen_and_the_legend_folds(
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
    _until(browser, "return document.body.dataset.ready === 'yes'")
    assert browser.execute_script("return document.getElementById('legend').open")

    choose("speed", "8")
    assert browser.execute_script("return animator.mixer.timeScale") == 8.0

    _, radius = surroundings(made._frames)
    camera = "return viewer.camera.position.toArray()"
    for name, place in (("front", [1.0, 0.0, 0.0]), ("side", [0.0, -1.0, 0.0])):
        choose("camera", name)
        x, y, z = np.array(place) * 1.65 * radius
        np.testing.assert_allclose(browser.execute_script(camera), [x, z, -y], atol=1e-3)

    choose("camera", "base")
    browser.execute_script("seek(12.0)")
    root, turn = browser.execute_script(
        """const root = viewer.scene_tree.find(["ffsms"]).object;
        return [root.position.toArray(), root.quaternion.toArray()]"""
    )
    scene_root = pin.XYZQUATToSE3(np.array([*root, *turn]))
    centre, _ = surroundings(made._frames)
    stays = pin.SE3(np.eye(3), -centre) * pin.XYZQUATToSE3(plan.q[0, :7])
    base = scene_root * pin.XYZQUATToSE3(plan.q[-1, :7])
    np.testing.assert_allclose(base.homogeneous, stays.homogeneous, atol=1e-4)
    choose("camera", "free")
    root = browser.execute_script("return viewer.scene_tree.find(['ffsms']).object.position.toArray()")
    np.testing.assert_allclose(root, -centre, atol=1e-4)

    _until(browser, "return !document.getElementById('legend').open")
    assert _errors(browser) == []


def test_the_live_page_shows_the_motion(
    browser: webdriver.Chrome, scene: View, planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    browser.get(scene.open(browser=False))
    _until(browser, "return viewer.animator.duration > 11.9 && viewer.animator.time > 0.0")
    eye = Eye(browser, scene, SIDE)
    browser.execute_script("viewer.animator.pause()")
    for t, other in ((0.4, plan.q[-1]), (11.0, plan.q[0])):
        browser.execute_script("viewer.animator.time_scrubber.setValue(arguments[0])", t)
        _check(eye, planar, _at(planar, plan, t), plan.target, other)
    assert _errors(browser) == []
    scene.close()


def test_a_running_simulation_is_shown(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    def places() -> list[Array]:
        script = """return ["link_1_0", "link_3_0"].map((name) =>
            viewer.scene_tree.find(["ffsms", "robot", "visuals", name]).object.position.toArray())"""
        return [np.array(place) for place in browser.execute_script(script)]

    shapes: dict[str, Any] = {item.name: item for item in planar.geometry("visual").geometryObjects}

    def wanted(q: Array) -> list[Array]:
        data = planar.model.createData()
        pin.forwardKinematics(planar.model, data, q)
        found = [shapes[name] for name in ("link_1_0", "link_3_0")]
        return [np.array(data.oMi[item.parentJoint].act(item.placement.translation)) for item in found]

    count = "return viewer.num_messages_received"
    with LiveView(planar, plan.q[0], plan.target, speed=20.0, fps=10.0, browser=False) as live:
        browser.get(live.url)
        _until(browser, "return typeof viewer === 'object' && viewer.num_messages_received > 10")
        _until(browser, _near(wanted(plan.q[0])[1]))
        before = browser.execute_script(count)
        controller = ffsms.SlidingModeController(planar)
        tracking = ffsms.simulate(planar, live.watch(plan), controller, dt=0.05)
        _until(browser, f"return viewer.num_messages_received > {before} + 50")
        live.show(12.0, tracking.q[-1], tracking.v[-1])
        last = wanted(tracking.q[-1])
        _until(browser, _near(last[1]))
        np.testing.assert_allclose(places(), last, atol=1e-6)


def test_the_live_page_evaluates_no_text(browser: webdriver.Chrome, scene: View) -> None:
    browser.get(scene.open(browser=False))
    _until(browser, "return typeof viewer === 'object' && viewer.num_messages_received > 10")
    # Later, since what the driver runs at once is exempt from the page's policy.
    attack = """const done = arguments[arguments.length - 1];
        const command = {type: "set_control", name: "x", callback: "window.owned = true"};
        setTimeout(() => {
            try { viewer.handle_command(command); done("evaluated"); } catch (problem) { done(problem.name); }
        }, 50);"""
    assert browser.execute_async_script(attack) == "EvalError"
    # What one page sends reaches no other page, and not this one either.
    count = browser.execute_script("return viewer.num_messages_received")
    for message in ("'x'", "JSON.stringify({type: 'set_control'})", "new Uint8Array([1, 2, 3])"):
        browser.execute_script(f"viewer.connection.send({message})")
    time.sleep(0.5)
    assert browser.execute_script("return viewer.num_messages_received") == count
    assert browser.execute_script("return [viewer.connection.readyState, window.owned]") == [1, None]
    _errors(browser)  # the browser notes what its policy has refused
    scene.close()


def _near(place: Array) -> str:
    """Script that says whether the last link has come to a place."""
    return f"""const p = viewer.scene_tree.find(["ffsms", "robot", "visuals", "link_3_0"]).object.position;
        const wanted = {json.dumps(place.tolist())};
        return Math.hypot(p.x - wanted[0], p.y - wanted[1], p.z - wanted[2]) < 1e-6"""


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
    _until(browser, "return document.body.dataset.ready === 'yes'")
    count = """let count = 0;
        viewer.scene_tree.find(["ffsms", "robot"]).object.traverse((item) => {
            if (item.isMesh && item.geometry.attributes.position.count > 100) count += 1; });
        return count"""
    meshes = [item for item in sms.geometry("visual").geometryObjects if item.meshPath.endswith(".dae")]
    assert browser.execute_script(count) == len(meshes) > 4
    assert _errors(browser) == []
