"""What a real browser shows of the live page (see `browsing`)."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
import pinocchio as pin
from browsing import (
    SIDE,
    Eye,
    check,
    configuration_at,
    errors,
    until,
)
from numpy.typing import NDArray
from selenium import webdriver

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.viewer import LiveView, View

Array = NDArray[np.float64]


def test_the_live_page_shows_the_motion(
    browser: webdriver.Chrome, scene: View, planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    browser.get(scene.open(browser=False))
    until(browser, "return viewer.animator.duration > 11.9 && viewer.animator.time > 0.0")
    eye = Eye(browser, scene, SIDE)
    browser.execute_script("viewer.animator.pause()")
    for t, other in ((0.4, plan.q[-1]), (11.0, plan.q[0])):
        browser.execute_script("viewer.animator.time_scrubber.setValue(arguments[0])", t)
        check(eye, planar, configuration_at(planar, plan, t), plan.target, other)
    assert errors(browser) == []
    scene.close()


def test_a_running_simulation_is_shown(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    def seen() -> list[Array]:
        script = """return ["link_1_0", "link_3_0"].map((name) =>
            viewer.scene_tree.find(["ffsms", "robot", "visuals", name]).object.position.toArray())"""
        return [np.array(place) for place in browser.execute_script(script)]

    shapes: dict[str, Any] = {item.name: item for item in planar.geometry("visual").geometryObjects}

    def wanted(q: Array) -> list[Array]:
        data = planar.model.createData()
        pin.forwardKinematics(planar.model, data, q)
        found = [shapes[name] for name in ("link_1_0", "link_3_0")]
        return [np.array(data.oMi[item.parentJoint].act(item.placement.translation)) for item in found]

    # Every step is shown, so that what the page comes to does not hang on this machine's speed.
    with LiveView(planar, plan.q[0], plan.target, speed=None, fps=1e9, browser=False) as live:
        browser.get(live.url)
        until(browser, "return typeof viewer === 'object' && viewer.num_messages_received > 10")
        until(browser, _near(wanted(plan.q[0])[1]))
        controller = ffsms.SlidingModeController(planar)
        tracking = ffsms.simulate(planar, live.watch(plan), controller, dt=0.05)
        until(browser, _near(wanted(tracking.q[-2])[1]))  # the last that the reference was asked for
        live.show(12.0, tracking.q[-1], tracking.v[-1])
        last = wanted(tracking.q[-1])
        until(browser, _near(last[1]))
        np.testing.assert_allclose(seen(), last, atol=1e-6)


def test_the_live_page_has_time_bar_speed_and_legend(browser: webdriver.Chrome, scene: View) -> None:
    """As the saved page has them: dragged, chosen and switched, and the scene follows."""
    browser.get(scene.open(browser=False))
    until(browser, "return document.body.dataset.ready === 'yes'")
    browser.execute_script("""byId("speed").value = "4"; byId("speed").dispatchEvent(new Event("change"));
        byId("slider").value = 3; byId("slider").dispatchEvent(new Event("input"));""")
    assert browser.execute_script("return [viewer.animator.mixer.timeScale, viewer.animator.time]") == [4, 3]
    assert browser.execute_script("return byId('reading').textContent").startswith("t = 3.00 s")
    box = "document.querySelector('#legend input[data-layer=target]')"
    node = "viewer.scene_tree.find(['ffsms', 'target']).object.visible"
    assert browser.execute_script(f"const was = {node}; {box}.click(); return [was, {node}]") == [True, False]
    assert errors(browser) == []
    scene.close()


def test_the_page_of_a_run_says_its_time(
    browser: webdriver.Chrome, planar: ffsms.SpaceManipulator, plan: opt.Trajectory
) -> None:
    with LiveView(planar, plan.q[0], plan.target, speed=2.0, browser=False) as live:
        browser.get(live.url)
        until(browser, "return document.body.dataset.ready === 'yes'")
        live.watch(plan)  # which says how long it will be
        live.show(4.0, plan.q[80], plan.v[80])
        until(browser, "return byId('reading').textContent.startsWith('t = 4.00 s')")
        script = "const bar = byId('slider'); return [bar.disabled, +bar.value, +bar.max, byId('play')]"
        assert browser.execute_script(script) == [True, 4, 12, None]
        assert "at most 2 x" in browser.execute_script("return byId('time').textContent")
        assert browser.execute_script("return document.querySelectorAll('#legend input').length") > 4
        assert browser.execute_script("return document.querySelector('[data-layer=clearance]') !== null")
        assert errors(browser) == []


def test_the_live_page_evaluates_no_text(browser: webdriver.Chrome, scene: View) -> None:
    browser.get(scene.open(browser=False))
    until(browser, "return typeof viewer === 'object' && viewer.num_messages_received > 10")
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
    errors(browser)  # the browser notes what its policy has refused
    scene.close()


def _near(place: Array) -> str:
    """Script that says whether the last link has come to a place."""
    return f"""const p = viewer.scene_tree.find(["ffsms", "robot", "visuals", "link_3_0"]).object.position;
        const wanted = {json.dumps(place.tolist())};
        return Math.hypot(p.x - wanted[0], p.y - wanted[1], p.z - wanted[2]) < 1e-6"""
