"""Test that extreme values of descriptions, limits and states are interpreted or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidUrdf, InvalidValue
from ffsms_pin.inspection import inspect
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]
PLANAR = model_path("planar_3r").read_text()


def file(folder: Path, text: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text)
    return path


def test_huge_limits_are_infinite(tmp_path: Path) -> None:
    text = PLANAR
    for key, value in (("velocity", "1e300"), ("effort", "1e16"), ("lower", "-1e300"), ("upper", "3.4e38")):
        start = text.index(f'{key}="') + len(key) + 2
        text = text[:start] + value + text[text.index('"', start) :]
    limits = ffsms.load(file(tmp_path, text)).limits
    for limit in (limits.velocity, limits.acceleration, limits.torque, limits.upper):
        assert limit[0] == np.inf
        assert np.isfinite(limit[1:]).all()
    assert limits.lower[0] == -np.inf


def test_a_limit_of_30_rad_is_infinite_and_one_of_30_m_is_kept(random_tree: Any) -> None:
    """A limit of 30 is no limit for a revolute joint [rad], but a limit for a prismatic joint [m]."""
    for kind, far in (("revolute", np.inf), ("prismatic", 30.0)):
        model = random_tree(0, 2, (kind,)).model()
        upper = np.array(model.upperPositionLimit)
        upper[7:9] = 30.0, 1.0
        model.upperPositionLimit = upper
        read = ffsms.SpaceManipulator(model, "tip")
        np.testing.assert_array_equal(read.limits.upper, [far, 1.0])
        limits_of_30 = ffsms.RobotLimits(np.array([-30.0, -1.0]), np.array([30.0, 1.0]), *np.ones((3, 2)))
        limits = read.with_limits(limits_of_30).limits
        np.testing.assert_array_equal(limits.lower, [-far, -1.0])
        np.testing.assert_array_equal(limits.upper, [far, 1.0])


def test_tiny_limits_are_refused(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    good: dict[str, Any] = {
        name: getattr(planar.limits, name)
        for name in ("lower", "upper", "velocity", "acceleration", "torque")
    }
    for name in ("velocity", "acceleration", "torque"):
        bad = {**good, name: np.array([1e-30, 1.0, 1.0])}
        refused(lambda bad=bad: ffsms.RobotLimits(**bad), InvalidValue, f"limits.{name}", "1e-12")
    for value in ("wide", [["a"]], [None] * 3, [1j] * 3, np.ones((3, 1))):
        bad = {**good, "upper": value}
        refused(lambda bad=bad: ffsms.RobotLimits(**bad), InvalidValue, "limits.upper")


@pytest.mark.parametrize("depth", [101, 3_000, 100_000])
def test_nested_elements_are_refused(refused: Refused, tmp_path: Path, depth: int) -> None:
    nested = "<a>" * depth + "</a>" * depth
    path = file(tmp_path, PLANAR.replace("</robot>", f"{nested}</robot>"))
    for call in (ffsms.load, inspect):
        refused(lambda call=call: call(path), InvalidUrdf, "deeper than 100")


def test_files_with_too_many_elements_are_refused(refused: Refused, tmp_path: Path) -> None:
    links = "".join(f'<link name="w{i}"/>' for i in range(20_000))
    path = file(tmp_path, PLANAR.replace("</robot>", f"{links}</robot>"))
    refused(lambda: ffsms.load(path), InvalidUrdf, "more than 20000 elements")
    lol = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
    path = file(tmp_path, f'<!DOCTYPE robot [<!ENTITY a0 "lol">{lol}]><robot name="&a11;"/>')
    refused(lambda: ffsms.load(path), InvalidUrdf, "XML")


@pytest.mark.parametrize("value", [1e10, 1e300, -1e30, np.inf])
def test_states_far_away_are_refused(refused: Refused, planar: ffsms.SpaceManipulator, value: float) -> None:
    q = planar.configuration([0.1, 0.2, 0.3])
    far = q.copy()
    far[0] = value
    refused(lambda: planar.at(far), InvalidValue, "q must")
    refused(lambda: planar.velocity(far, np.zeros(3)), InvalidValue, "q must")
    refused(lambda: planar.at(q).drift(np.full(6, value)), InvalidValue, "momentum must")


def test_invalid_poses_are_refused(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    for pose in (pin.SE3(1e300 * np.eye(3), np.zeros(3)), pin.SE3(np.eye(3), np.full(3, 1e30))):
        refused(lambda pose=pose: planar.configuration(np.zeros(3), pose), InvalidValue, "base must")
        refused(lambda pose=pose: ffsms.mount("planar_3r", placement=pose), InvalidValue, "placement must")
        made = {"model": planar.model, "end_effector": planar.end_effector, "base_box_placement": pose}
        refused(lambda made=made: ffsms.SpaceManipulator(**made), InvalidValue, "base_box_placement must")
