"""A compliant grasp: momentum kept, energy only lost, and the grasp drawn together."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.client import after_capture
from ffsms_pin.simulation.compliant import CompliantContact, compliant_contact
from ffsms_pin.system.dynamics import centroidal

GRASP = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.4]))


def _about_origin(whole: Any, client: ffsms.Client) -> np.ndarray:
    own, place = client.momentum, client.pose(0.0).translation
    angular = (
        whole.momentum[3:] + np.cross(whole.com, whole.momentum[:3]) + own[3:] + np.cross(place, own[:3])
    )
    return np.concatenate([whole.momentum[:3] + own[:3], angular])


@pytest.fixture(scope="module")
def touch() -> tuple[ffsms.SpaceManipulator, np.ndarray, np.ndarray, ffsms.Client, CompliantContact]:
    """The end effector touches 3 mm and a degree beside the grasp, with 20 mm/s."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.3, 0.1, 0.2, -1.4, 0.1, 3.3, 1.0])
    v = sms.velocity(q, np.full(sms.n, 0.01), [0.5, 0.0, -0.5, 0.1, 0.2, 0.3])
    aside = pin.SE3(pin.exp3(np.array([0.01, -0.015, 0.0])), np.array([0.002, -0.002, 0.001]))
    client = ffsms.Client(
        80.0,
        [6.0, 9.0, 11.0],
        sms.at(q).end_effector_pose * aside * GRASP.inverse(),
        [0.02, 0.0, 0.01, 0.03, 0.02, -0.03],
    )
    contact = compliant_contact(sms, q, v, client, 0.0, goal=opt.Meet(client, GRASP), dt=2e-3, time=0.3)
    return sms, q, v, client, contact


def test_the_momentum_is_kept_and_energy_only_lost(touch: Any) -> None:
    sms, q, v, client, contact = touch
    start, end = centroidal(sms, q, v), centroidal(sms, contact.q[-1], contact.v[-1])
    before, after = _about_origin(start, client), _about_origin(end, contact.client)
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-12 * float(np.linalg.norm(before)))
    energy = start.kinetic_energy + client.kinetic_energy - end.kinetic_energy - contact.client.kinetic_energy
    strained = 0.5 * 500.0 * 0.003**2 + 0.5 * 20.0 * 0.018**2
    assert energy > -strained


def test_the_grasp_is_drawn_together(touch: Any) -> None:
    sms, q, v, client, contact = touch
    tip, grasp = sms.at(contact.q[-1]).end_effector_pose, contact.client.pose(0.0) * GRASP
    missed = np.linalg.norm(tip.translation - grasp.translation)
    assert missed < 0.7 * np.linalg.norm([0.002, -0.002, 0.001])
    # What is left of the relative velocity when it becomes rigid costs less than a weld at the first touch.
    later = after_capture(sms, contact.q[-1], contact.v[-1], contact.client)
    assert later.energy_lost < after_capture(sms, q, v, client).energy_lost
    # Force and torque grow from what the first touch makes of 3 mm and 20 mm/s.
    assert 1.0 < contact.largest_force < 10.0


def test_both_ways_end_with_the_same_total(touch: Any) -> None:
    sms, q, v, client, contact = touch
    weld = after_capture(sms, q, v, client)
    soft = after_capture(sms, contact.q[-1], contact.v[-1], contact.client)
    np.testing.assert_allclose(soft.momentum[:3], weld.momentum[:3], atol=1e-12)
    np.testing.assert_allclose(soft.momentum[3:], weld.momentum[3:], atol=1e-12)
