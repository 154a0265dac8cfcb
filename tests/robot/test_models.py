"""Compare arms on satellites and the packaged robots with sums over the links of their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from link_sums import FIXED, Z_TO_X, arm_file, check, cube, on_satellite, parts_of, rpy

import ffsms_pin as ffsms
from ffsms_pin.urdf import model_path


@pytest.mark.parametrize("arm", ["panda", "xarm7", "ur5", "ur10", "z1", "kinova"])
def test_arms_on_the_default_satellite(arm: str) -> None:
    sms = ffsms.load(f"satellite_{arm}")
    assert sms.n == (7 if arm in ("panda", "xarm7") else 6)
    assert sms.nq == 7 + sms.n + (3 if arm == "kinova" else 0)
    assert sms.base_size == (1.0, 1.0, 1.0)
    parts = on_satellite(
        parts_of(arm_file(arm)), cube(), Z_TO_X, np.array([0.5, 0.0, 0.0]), FIXED.get(arm, ())
    )
    total = sum(body.mass for body in sms.model.inertias)
    assert total == pytest.approx(sum(part.mass for part in parts), rel=1e-14)  # including the fingers
    check(sms, parts)


@pytest.mark.parametrize(
    ("robot", "tool"),
    [
        ("servicer", "probe_tip"),
        ("space_arm_7", "end_effector"),
        ("two_arms", "left_tool"),
        ("two_arms", "right_tool"),
    ],
)
def test_packaged_robots(robot: str, tool: str) -> None:
    sms = ffsms.load(robot, end_effector=tool)
    assert sms.n == {"servicer": 7, "space_arm_7": 7, "two_arms": 14}[robot]
    check(sms, parts_of(model_path(robot)))
    assert np.isfinite(sms.limits.velocity).all()
    assert np.isfinite(sms.limits.torque).all()


def test_a_custom_satellite(rng: Any) -> None:
    tensor = np.array([[30.0, 1.0, -2.0], [1.0, 25.0, 0.5], [-2.0, 0.5, 20.0]])
    base = ffsms.SatelliteBase(
        150.0, (1.2, 0.8, 0.9), inertia=tensor, com=(0.1, -0.05, 0.2), panels=(2.0, 0.6)
    )
    place = pin.SE3(rpy(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-1.0, 1.0, 3))
    sms = ffsms.mount("kinova", base, place, end_effector="j2s6s200_link_4")
    body = cube()._replace(mass=150.0, com=np.array([0.1, -0.05, 0.2]), inertia=tensor)
    check(sms, on_satellite(parts_of(arm_file("kinova")), body, place.rotation, place.translation))
    assert sms.base_size == (1.2, 0.8, 0.9)
    np.testing.assert_array_equal(sms.base_box_placement.translation, np.zeros(3))


MIXED = """<robot name="mixed">
<link name="bus"><inertial><origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/><mass value="40"/>
<inertia ixx="5" ixy="0.1" ixz="0" iyy="4" iyz="0" izz="3"/></inertial></link>
<link name="tank"><inertial><mass value="15"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0.05" izz="1"/></inertial></link>
<link name="mast"/>
<link name="slider"><inertial><origin xyz="0 0.1 0"/><mass value="3"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="wheel"><inertial><origin xyz="0.1 0.1 0"/><mass value="4"/>
<inertia ixx="0.2" ixy="0" ixz="0.01" iyy="0.2" iyz="0" izz="0.1"/></inertial></link>
<link name="branch"><inertial><origin xyz="0.2 0 0" rpy="1 0 0"/><mass value="2"/>
<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="hand"/>
<joint name="t" type="fixed"><parent link="bus"/><child link="tank"/>
<origin xyz="0 0.5 0" rpy="0 0 1"/>
</joint>
<joint name="m" type="fixed"><parent link="tank"/><child link="mast"/>
<origin xyz="0.3 0 0" rpy="0.4 0 0"/>
</joint>
<joint name="j1" type="prismatic"><parent link="mast"/><child link="slider"/>
<origin xyz="0 0.2 0" rpy="0 1 0"/>
<axis xyz="1 2 2"/><limit lower="-1" upper="1" velocity="0.1" effort="10"/>
</joint>
<joint name="j2" type="continuous"><parent link="slider"/><child link="wheel"/>
<origin xyz="0.1 0.2 0"/>
<axis xyz="0 0.6 0.8"/>
</joint>
<joint name="j3" type="revolute"><parent link="slider"/><child link="branch"/>
<origin xyz="0 0 0.3" rpy="1 1 1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="0.1" effort="10"/>
</joint>
<joint name="h" type="fixed"><parent link="branch"/><child link="hand"/>
<origin xyz="0.4 0 0" rpy="0 0 2"/>
</joint>
</robot>"""


def test_mixed_joints_branches_and_a_base_of_several_links(tmp_path: Path) -> None:
    path = tmp_path / "mixed.urdf"
    path.write_text(MIXED)
    parts = parts_of(path)
    check(ffsms.load(path, end_effector="hand"), parts)
    sms = ffsms.mount(path, end_effector="wheel")
    check(sms, on_satellite(parts, cube(), Z_TO_X, np.array([0.5, 0.0, 0.0])))
    # The continuous joint has no rate limit in the file.
    assert sms.limits.velocity[sms.joint_names.index("j2")] == 0.5
    assert np.isinf(sms.limits.torque[sms.joint_names.index("j2")])
    np.testing.assert_array_equal(ffsms.mount(path, end_effector="wheel", velocity=0.3).limits.velocity, 0.3)
