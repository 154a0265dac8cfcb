"""Test that pairs of links that an SRDF disables have no clearance."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import GeometryError, InvalidValue
from ffsms_pin.geometry.bodies import BodyStack
from ffsms_pin.urdf import model_path

SRDF = """<?xml version="1.0"?>
<robot name="space_arm_7">
  <disable_collisions link1="link_1" link2="link_4" reason="Never"/>
</robot>
"""


def pairs(sms: ffsms.SpaceManipulator) -> set[str]:
    return set(BodyStack(sms, "hulls", 0.0).names)


def test_disabled_pairs_are_left_out(tmp_path: Path) -> None:
    """Test a file that is passed as argument, and a file beside the URDF."""
    plain = ffsms.load("space_arm_7")
    assert "link_1 - link_4" in pairs(plain)
    file = tmp_path / "pairs.srdf"
    file.write_text(SRDF, encoding="utf-8")
    assert pairs(plain) - pairs(ffsms.load("space_arm_7", srdf=file)) == {"link_1 - link_4"}
    shutil.copy(model_path("space_arm_7"), tmp_path / "arm.urdf")
    assert pairs(ffsms.load(tmp_path / "arm.urdf")) == pairs(plain)
    (tmp_path / "arm.srdf").write_text(SRDF, encoding="utf-8")
    beside = ffsms.load(tmp_path / "arm.urdf")
    assert pairs(plain) - pairs(beside) == {"link_1 - link_4"}
    assert not beside.geometry("visual").collisionPairs


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match="srdf must be the path of an existing file"):
        ffsms.load("space_arm_7", srdf=tmp_path / "absent.srdf")
    with pytest.raises(InvalidValue, match="srdf must be a path"):
        ffsms.load("space_arm_7", srdf=3)  # type: ignore[arg-type]
    broken = tmp_path / "broken.srdf"
    broken.write_text("<robot", encoding="utf-8")
    sms = ffsms.load("space_arm_7", srdf=broken)
    with pytest.raises(GeometryError, match="cannot be read as an SRDF"):
        sms.geometry("collision")
