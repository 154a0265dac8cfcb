"""Load a robot of your own from a URDF whose root link is the satellite; `load` adds the free-flyer."""

from pathlib import Path

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt

LINK = """<link name="{name}"><inertial><origin xyz="{com} 0 0"/><mass value="{mass}"/>
  <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="{com} 0 0"/><geometry><box size="{size}"/></geometry></collision></link>"""
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="{x} 0 0"/><axis xyz="{axis}"/>
  <limit lower="-2.5" upper="2.5" velocity="0.5" effort="5"/></joint>"""
parts = [
    LINK.format(name="satellite", com=0, mass=60, inertia=4, size="0.6 0.6 0.6"),
    JOINT.format(name="shoulder", parent="satellite", child="upper", x=0.35, axis="0 0 1"),
    LINK.format(name="upper", com=0.3, mass=4, inertia=0.15, size="0.5 0.06 0.06"),
    JOINT.format(name="elbow", parent="upper", child="lower", x=0.6, axis="0 1 0"),
    LINK.format(name="lower", com=0.3, mass=3, inertia=0.1, size="0.5 0.06 0.06"),
    JOINT.format(name="wrist", parent="lower", child="tool", x=0.6, axis="0 1 0"),
    LINK.format(name="tool", com=0.1, mass=1, inertia=0.01, size="0.1 0.04 0.04"),
    '<joint name="end" type="fixed"><parent link="tool"/><child link="tip"/><origin xyz="0.2 0 0"/></joint>',
    '<link name="tip"/>',
]
path = Path("own_robot.urdf")
path.write_text('<robot name="own">' + "\n".join(parts) + "</robot>", encoding="utf-8")

sms = ffsms.load(path, end_effector="tip")
q0 = sms.configuration([0.4, 0.8, 0.3])
state = sms.at(q0)
target = state.end_effector_pose.translation + np.array([-0.15, -0.1, 0.05])
plan = opt.plan(sms, q0, target, duration=8.0)
turn = np.degrees(plan.base_rotation.max())
print(f"joints {', '.join(sms.joint_names)}; base box {sms.base_size} m")
print(f"{1e3 * plan.position_error[-1]:.3f} mm off, base turned by {turn:.1f} deg")
assert plan.reached
