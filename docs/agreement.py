"""The page that says how closely other engines agree, computed while the site is built."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from engines import ROBOTS, Adam, Found, Mujoco, apart, ours, random_state, robot  # noqa: E402

from ffsms_pin.urdf import model_path  # noqa: E402

STATES = 20
HEAD = f"""# Agreement with other engines

What MuJoCo and adam make of the same robots at {STATES} random states (a tumbling base anywhere, moving
joints): the largest difference from ours, relative to the largest entry. Each engine's results were turned
into the paper's convention first. These numbers were computed while this page was built. `tests/validation`
keeps them below 1e-11, and compares ten seconds of motion under the same torques with MuJoCo's Runge-Kutta:
joint rates agree to 1e-9 rad/s.

adam reads a URDF, so it has the robots that are one file.

"""


def page() -> str:
    """The page in Markdown."""
    lines = [f"| robot | engine | {' | '.join(Found._fields)} |", "|---|---|" + "---|" * len(Found._fields)]
    for name in ROBOTS:
        sms = robot(name)
        engines = [("MuJoCo", Mujoco(sms))]
        if not name.startswith("satellite"):
            engines.append(("adam", Adam(sms, str(model_path(name)))))
        for title, engine in engines:
            rng = np.random.default_rng(1)
            worst = dict.fromkeys(Found._fields, 0.0)
            for _ in range(STATES):
                q, v = random_state(sms, rng)
                for key, value in apart(ours(sms, q, v), engine.found(q, v)).items():
                    worst[key] = max(worst[key], value)
            lines.append(f"| {name} | {title} | " + " | ".join(f"{x:.0e}" for x in worst.values()) + " |")
    return HEAD + "\n".join(lines) + "\n"
