"""Define a small campaign for tests, with runs of 0.2 s."""

from __future__ import annotations

from scenario_files import IN_RADIANS

CAMPAIGN = f"""{IN_RADIANS}\
[plan]
duration = 3.0
dt = 0.05
method = "resolved-rate"
[control]
law = "sliding-mode"
dt = 0.02
[sensors]
joint_noise_deg = 0.01
[[fault]]
time = 2.0
joint = 2
[campaign]
seed = 100
[campaign.draw]
plant.arm_mass = {{ uniform = [0.8, 1.2] }}
plant.base_mass = {{ normal = [1.0, 0.05] }}
target.position = {{ uniform = [[0.70, 0.45, 0.0], [0.80, 0.55, 0.0]] }}
fault.1 = {{ choice = [{{}}, {{ time = 1.0, joint = 1 }}] }}
control.law = {{ choice = ["sliding-mode", "computed-torque"] }}
"""
