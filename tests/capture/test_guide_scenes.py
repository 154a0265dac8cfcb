"""Contacts of ready scenes: a cone guides a probe into a throat, and a gripper holds a ring by friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from two_bodies import TwoBodies

from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.capture.guides import gripper_on_ring, probe_in_nozzle
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue

PLACE = pin.SE3(pin.exp3(np.array([0.3, 0.2, 0.1])), np.array([0.1, 0.0, -2.0]))
HERE, REST = pin.SE3.Identity(), np.zeros(6)
HEAVY = (1e6, [1e6] * 3)


def _moved(pose: Any, *displacement: float, rotation_vector: Any = (0.0, 0.0, 0.0)) -> Any:
    return pose * pin.SE3(pin.exp3(np.array(rotation_vector)), np.array(displacement))


@pytest.mark.parametrize("angle", np.linspace(0.0, np.pi, 6))
def test_the_probe_has_its_play_in_the_throat(angle: float) -> None:
    scene = probe_in_nozzle(PLACE)
    across = np.array([np.cos(angle), np.sin(angle), 0.0])

    def contact_force(distance: float) -> FloatArray:
        tip = _moved(scene.grasp, *(distance * across))
        touches = scene.load.touches(tip, REST, HERE, REST)
        force: FloatArray = sum((touch.force for touch in touches), np.zeros(3))
        return np.asarray(tip.rotation.T @ force)

    assert not contact_force(0.00139).any()
    # A side of the octagon stands back by cos(pi / 8) at most, and pushes back towards the middle.
    assert contact_force(0.0014 / np.cos(np.pi / 8) + 1e-5) @ across < 0.0
    assert contact_force(0.0)[2] == 0.0


def test_the_floor_and_the_cone_push_back() -> None:
    scene = probe_in_nozzle(PLACE)
    for displacement, pushes in (
        ((0.0, 0.0, 0.0076), True),
        ((0.0, 0.0, 0.0074), False),
        ((0.05, 0.0, -0.15), True),
    ):
        wrench, _ = scene.load.wrench(_moved(scene.grasp, *displacement), REST, HERE, REST)
        assert ((scene.grasp.rotation.T @ wrench[:3])[2] < 0.0) == pushes


@pytest.mark.parametrize("guided", [True, False])
def test_the_cone_guides_a_probe_that_is_aimed_beside_the_throat(guided: bool) -> None:
    """A soft spring aims 12 mm and a degree beside the throat; the probe ends in it only with the nozzle."""
    scene = probe_in_nozzle(PLACE, damping=50.0, friction=0.1)
    aim = GripLoad(
        _moved(scene.grasp, 0.012, 0.0, 0.0, rotation_vector=[0.0, 0.017, 0.0]), 100.0, 70.0, 20.0, 15.0
    )
    bodies = TwoBodies((20.0, HEAVY[0]), ([2.0] * 3, HEAVY[1]), [aim, *([scene.load] if guided else [])])
    start = [_moved(scene.grasp, 0.012, 0.0, -0.2), HERE]
    motion = bodies.run(start, np.zeros((2, 6)), 2e-3, 1500)
    tip = scene.grasp.actInv(bodies.states(motion.q[-1], motion.v[-1])[0][0])
    aside = float(np.hypot(*tip.translation[:2]))
    if guided:
        assert aside < 0.0025  # the play and the bending of the rod
        assert -0.037 < tip.translation[2] < 0.01
    else:
        assert aside > 0.011


@pytest.mark.parametrize("share", [0.6, 1.6])
def test_a_closed_gripper_holds_the_ring_by_friction(share: float) -> None:
    scene = gripper_on_ring(PLACE, opening=0.004, transition=1e-3)
    squeeze = 8 * scene.load.stiffness * 0.0005**1.5
    pull = share * scene.load.friction * squeeze
    force = scene.grasp.rotation @ np.array([0.0, 0.0, -pull])  # off the ring
    bodies = TwoBodies((10.0, HEAVY[0]), ([0.2] * 3, HEAVY[1]), [scene.load], [*force, 0.0, 0.0, 0.0])
    motion = bodies.run([scene.grasp, HERE], np.zeros((2, 6)), 2e-4, 300)
    pose, _ = bodies.states(motion.q[-1], motion.v[-1])
    slip = -scene.grasp.actInv(pose[0]).translation[2]
    if share < 1.0:
        assert slip == pytest.approx(1e-3 * np.arctanh(share) * 0.06, rel=0.1)  # it creeps
    else:
        assert slip == pytest.approx(0.5 * (pull - scene.load.friction * squeeze) / 10.0 * 0.06**2, rel=0.05)


def test_an_open_gripper_touches_the_ring_beyond_its_play() -> None:
    scene = gripper_on_ring(PLACE)
    for displacement, pushed in (
        ((0.0, 0.0, 0.0), [0, 0, 0]),
        ((0.0, 0.017, 0.0), [0, 0, 0]),
        ((0.0, 0.018, 0.0), [0, -1, 0]),
        ((0.0, -0.018, 0.0), [0, 1, 0]),
        ((0.0, 0.0, 0.001), [0, 0, -1]),
        ((0.0, 0.0, -0.06), [0, 0, 0]),
    ):
        wrench, _ = scene.load.wrench(_moved(scene.grasp, *displacement), REST, HERE, REST)
        force = scene.grasp.rotation.T @ wrench[:3]
        np.testing.assert_array_equal(np.sign(np.round(force, 6)), pushed)
    assert len(scene.shapes) == 36


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"probe_radius": 0.01}, "throat_radius must lie between"),
        ({"probe_length": 0.01}, "probe_length must be more than twice"),
        ({"depth": 0.05}, "depth must lie between 0 and"),
        ({"sides": 2}, "sides must be a whole number"),
    ],
)
def test_bad_nozzles_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        probe_in_nozzle(**{"place": PLACE, **values})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"thickness": 1.0}, "thickness must be below ring_radius"),
        ({"segments": 10**9}, "segments must be at most 360"),
    ],
)
def test_bad_rings_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        gripper_on_ring(**{"place": PLACE, **values})
