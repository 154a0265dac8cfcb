"""Make the page that compares results with other engines; the site's build computes the results."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from engine_motions import basilisk_end, mujoco_end, our_end, push, rate_difference  # noqa: E402
from engines import ROBOTS, Adam, Mujoco, PaperMatrices, ours, random_state, relative_differences, robot  # noqa: E402
from published_run import (  # noqa: E402
    PUBLISHED,
    mujoco_end as mujoco_base_end,
    our_end as our_base_end,
    planar_robot,
)

from ffsms_pin.urdf import model_path  # noqa: E402

STATES = 20
HEAD = f"""# Agreement with other engines

MuJoCo, adam and Basilisk are independent of ffsms-pin and use other formulations of the dynamics. The
tables compare their results, converted to the paper's conventions, with the results of ffsms-pin. All
numbers were computed while this page was built. The tests in `tests/validation` fail if a difference
exceeds 1e-11 for matrices or 1e-9 for motions.

## Matrices

MuJoCo and adam compute the matrices of the same robots at {STATES} random states, with a random base pose,
a tumbling base and moving joints. The table has the largest difference of each quantity between the engine
and ffsms-pin, divided by the quantity's largest entry. adam reads a URDF, so it computes only robots that
are described by a single file. Basilisk returns no matrices; the next section compares its motions.

"""
MOTIONS = """
## Ten seconds of motion

All robots start at rest. The joint torques are the same sinusoidal functions of time in all engines,
constant within each step. All engines integrate by a Runge-Kutta method of order 4, MuJoCo with steps of
0.5 ms and Basilisk with steps of 5 ms. For each comparison ffsms-pin uses the step of the other engine. The
table has the norm of the difference of the final joint rates, divided by the norm of the final joint rates.

In Basilisk a robot is a rigid hub with a chain of spinning bodies (`spinningBodyNDOFStateEffector`) for
each arm, solved by back-substitution. `to_basilisk` in `examples/basilisk_robot.py` builds the Basilisk
robot. Prismatic joints, and arms that branch beyond the base, cannot be represented; none of the six
robots has them.

"""

PUBLISHED_RUN = """

## A published run

The paper's author published a MATLAB simulation of a planar robot under PD control. The robot starts at
rest with zero joint positions, and the desired joint positions are (-30, 0, 0) deg. The simulation ends
after 20 s. The published final base pose was read from plots, with an accuracy of millimetres. The gains
are 1 N m/rad and 1 N m s/rad. Other gains under which the robot comes to rest change the final base pose by
less than 1e-5.

| engine | base x [m] | base y [m] | base angle [rad] |
|---|---|---|---|
"""


def page() -> str:
    """Return the page in Markdown."""
    lines = [
        f"| robot | engine | {' | '.join(PaperMatrices._fields)} |",
        "|---|---|" + "---|" * len(PaperMatrices._fields),
    ]
    for name in ROBOTS:
        sms = robot(name)
        engines = [("MuJoCo", Mujoco(sms))]
        if not name.startswith("satellite"):
            engines.append(("adam", Adam(sms, str(model_path(name)))))
        for title, engine in engines:
            rng = np.random.default_rng(1)
            worst = dict.fromkeys(PaperMatrices._fields, 0.0)
            for _ in range(STATES):
                q, v = random_state(sms, rng)
                for key, value in relative_differences(ours(sms, q, v), engine.matrices(q, v)).items():
                    worst[key] = max(worst[key], value)
            lines.append(f"| {name} | {title} | " + " | ".join(f"{x:.0e}" for x in worst.values()) + " |")
    return HEAD + "\n".join(lines) + "\n" + MOTIONS + "\n".join(_motions()) + "\n" + _published_run() + "\n"


def _published_run() -> str:
    """Return the section that compares the final base pose of the published run."""
    with TemporaryDirectory() as folder:
        sms = planar_robot(Path(folder))
        ends = {"ffsms-pin": our_base_end(sms), "MuJoCo": mujoco_base_end(sms), "published": PUBLISHED}
    rows = [f"| {name} | {x:.5g} | {y:.5g} | {angle:.5g} |" for name, (x, y, angle) in ends.items()]
    return PUBLISHED_RUN + "\n".join(rows)


def _motions() -> list[str]:
    lines = ["| robot | largest final joint rate [rad/s] | MuJoCo | Basilisk |", "|---|---|---|---|"]
    for name in ROBOTS:
        sms = robot(name)
        motion = push(sms)
        fine, coarse = our_end(sms, motion, 5e-4), our_end(sms, motion, 5e-3)
        fastest = np.abs(fine[1][6:]).max()
        mujoco = rate_difference(fine, mujoco_end(sms, motion, 5e-4))
        basilisk = rate_difference(coarse, basilisk_end(sms, motion, 5e-3))
        lines.append(f"| {name} | {fastest:.2f} | {mujoco:.0e} | {basilisk:.0e} |")
    return lines
