"""The power of a grip: the loss of its springs' energy, less the dissipation of its dampers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ffsms_pin.capture.grip import GripLoad
from ffsms_pin.simulation.loads import velocity_at

GRASP = pin.SE3(pin.exp3(np.array([0.4, -0.2, 0.9])), np.array([0.1, -0.3, 0.2]))
TOOL = pin.SE3(pin.exp3(np.array([0.5, 0.3, -0.2])), np.array([1.0, 0.2, 0.1]))
AWAY = pin.SE3(pin.exp3(np.array([0.1, -0.05, 0.08])), np.array([0.02, 0.01, -0.03]))
CLIENT = TOOL * AWAY * GRASP.inverse()
TWISTS = np.random.default_rng(3).normal(scale=0.1, size=(2, 6))


def _moved(pose: Any, twist: np.ndarray, t: float) -> Any:
    return pin.SE3(pin.exp3(t * twist[3:]) @ pose.rotation, pose.translation + t * twist[:3])


def _spring_energy(grip: GripLoad, t: float) -> float:
    tool, held = _moved(TOOL, TWISTS[0], t), _moved(CLIENT, TWISTS[1], t) * GRASP
    displacement = held.translation - tool.translation
    rotation = pin.log3(tool.rotation.T @ held.rotation)
    return float(
        0.5 * grip.stiffness * displacement @ displacement + 0.5 * grip.turn_stiffness * rotation @ rotation
    )


@pytest.mark.parametrize("damping", [0.0, 30.0])
def test_the_power_is_that_of_springs_and_dampers(damping: float) -> None:
    grip = GripLoad(GRASP, 400.0, damping, 15.0, 0.1 * damping)
    wrench, point = grip.wrench(TOOL, TWISTS[0], CLIENT, TWISTS[1])
    np.testing.assert_allclose(point, (CLIENT * GRASP).translation, atol=1e-15)
    slip = velocity_at(point, CLIENT, TWISTS[1]) - velocity_at(point, TOOL, TWISTS[0])
    spin = TWISTS[1, 3:] - TWISTS[0, 3:]
    power = -float(wrench[:3] @ slip + wrench[3:] @ spin)  # on both bodies together
    stored = (_spring_energy(grip, 1e-5) - _spring_energy(grip, -1e-5)) / 2e-5
    assert power == pytest.approx(-stored - damping * float(slip @ slip + 0.1 * spin @ spin), rel=1e-7)


def test_no_wrench_acts_at_rest_in_the_grasp_pose() -> None:
    wrench, _ = GripLoad(GRASP).wrench(CLIENT * GRASP, np.zeros(6), CLIENT, np.zeros(6))
    np.testing.assert_allclose(wrench, 0.0, atol=1e-11)
