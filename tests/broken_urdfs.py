"""Damage the URDF of the planar robot."""

from __future__ import annotations

import re
from pathlib import Path

import ffsms_pin as ffsms
from ffsms_pin.urdf import model_path

PLANAR = model_path("planar_3r").read_text()
JOINT_2 = PLANAR.index('<joint name="joint_2"')
LIMIT = re.compile(r"<limit lower[^>]*/>")
BOUNDS = 'lower="-2.827433388230814" upper="2.827433388230814"'
LIMIT_2 = str(LIMIT.findall(PLANAR)[1])


def in_link_2(old: str, new: str) -> str:
    start = PLANAR.index('<link name="link_2">')
    assert old in PLANAR[start:]
    return PLANAR[:start] + PLANAR[start:].replace(old, new, 1)


def in_joint_2(old: str, new: str) -> str:
    assert old in PLANAR[JOINT_2:]
    return PLANAR[:JOINT_2] + PLANAR[JOINT_2:].replace(old, new, 1)


def write(folder: Path, text: str) -> Path:
    path = folder / "broken.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def limits(sms: ffsms.SpaceManipulator) -> list[float]:
    joint_limits = sms.limits
    arrays = joint_limits.lower, joint_limits.upper, joint_limits.velocity, joint_limits.torque
    return [float(array[1]) for array in arrays]
