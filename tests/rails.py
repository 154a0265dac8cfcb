"""Define a robot with a prismatic joint: a cart on a rail carries a hand with a revolute joint."""

from __future__ import annotations

from pathlib import Path

import ffsms_pin as ffsms

RAIL = """<robot name="rail">
<link name="sat"><inertial><mass value="100"/>
  <inertia ixx="10" ixy="0" ixz="0" iyy="10" iyz="0" izz="10"/></inertial></link>
<link name="cart"><inertial><mass value="5"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="hand"><inertial><origin xyz="0.3 0 0"/><mass value="3"/>
  <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="sat"/><child link="cart"/><origin xyz="0 0 0.6"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="50" velocity="0.2"/></joint>
<joint name="wrist" type="revolute"><parent link="cart"/><child link="hand"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="50" velocity="0.5"/></joint>
</robot>"""


def sliding(folder: Path) -> ffsms.SpaceManipulator:
    """Write the robot's file into a folder, and load it."""
    file = folder / "rail.urdf"
    file.write_text(RAIL, encoding="utf-8")
    return ffsms.load(file, base_size=(0.4, 0.4, 0.4))
