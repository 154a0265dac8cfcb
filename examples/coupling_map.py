"""Map the coupling of an arm over its workspace: the base rotation per metre of tool motion.

Run: python examples/coupling_map.py [FIGURE]   (needs the extra [plot] when a figure is written)
"""

import sys

import numpy as np
from scipy.stats import binned_statistic_2d, qmc

import ffsms_pin as ffsms

sms = ffsms.load("planar_3r")
share = qmc.Sobol(sms.n, seed=0).random_base2(15)  # 32,768 evenly distributed points in the unit cube
joints = qmc.scale(share, sms.limits.lower, sms.limits.upper)
batch = sms.batch(joints)

# X maps a velocity of the end effector to the base's twist, for the smallest joint rates. The norm of
# its angular rows is the base rotation per metre in the worst direction. It is unbounded near singular
# postures: use medians, not means.
X = batch.C_bm @ np.linalg.pinv(batch.J_star[:, :3], rcond=1e-6)
rotation = np.degrees(np.linalg.norm(X[:, 3:], ord=2, axis=(1, 2)))  # [deg/m]

# Several postures have the same tool position. A planner can choose the posture of least rotation.
x, y, _ = batch.end_effector_position.T
least, edges_x, edges_y, _ = binned_statistic_2d(x, y, rotation, "min", bins=40)
median = binned_statistic_2d(x, y, rotation, "median", bins=(edges_x, edges_y)).statistic

print(f"entropy of the coupling: median {np.median(batch.entropy):.2f}")
print(f"base rotation: median {np.median(rotation):.0f} deg per metre of the end effector")
print(f"best posture of each cell: median {np.nanmedian(least):.0f} deg per metre")

# Check one state: in no direction of tool motion does the base rotate more than in the map.
state = sms.at(sms.configuration(joints[0]))
rates = np.linalg.pinv(state.J_star[:2]) @ np.random.default_rng(0).normal(size=(2, 1000))
turned = np.linalg.norm(state.C_bm[3:] @ rates, axis=0) / np.linalg.norm(state.J_star[:3] @ rates, axis=0)
assert abs(np.degrees(turned.max()) / rotation[0] - 1.0) < 1e-3
inside = np.isfinite(least)
assert (least[inside] <= median[inside]).all()

if len(sys.argv) > 1:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    titles = ("planar_3r: best posture of each cell", "planar_3r: median posture of each cell")
    for ax, title, cells in zip(figure.subplots(1, 2), titles, (least, median), strict=True):
        mesh = ax.pcolormesh(edges_x, edges_y, cells.T, vmin=0.0, vmax=60.0, cmap="cividis", rasterized=True)
        ax.set(title=title, xlabel="x from the base's centre of mass [m]", ylabel="y [m]", aspect="equal")
        figure.colorbar(mesh, ax=ax, label="base rotation [deg/m]", extend="max")
    figure.savefig(sys.argv[1], dpi=110)
