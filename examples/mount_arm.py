"""Mount an arm of example-robot-data on satellites of three masses, and compare their rotations.

The arms need the extra [robots].
"""

import numpy as np

import ffsms_pin as ffsms

turns = []
for mass, size in ((50.0, 0.6), (200.0, 1.0), (2000.0, 2.0)):
    base = ffsms.SatelliteBase(mass=mass, size=(size, size, size), panels=(2.0 * size, 0.5 * size))
    sms = ffsms.mount("xarm7", base, velocity=0.3)
    state = sms.at(sms.home())
    turns.append(np.degrees(np.linalg.norm(state.C_bm[3:], 2)))
    print(f"base of {mass:4.0f} kg: one radian of joint motion rotates it by up to {turns[-1]:5.2f} deg")
print(f"{sms.n} joints: {', '.join(sms.joint_names)}; tool frame '{sms.end_effector}'")
assert turns[0] > turns[1] > turns[2] > 0.0
