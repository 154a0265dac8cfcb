"""Time whole processes that import the library, and processes that import only Pinocchio and NumPy."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from typing import Any

import table
from timing import times

PROGRAMS = {
    "python alone": "pass",
    "import pinocchio, numpy": "import pinocchio, numpy",
    "import ffsms_pin": "import ffsms_pin",
    "load a model": "import ffsms_pin; ffsms_pin.load('planar_3r')",
    "first coupling": (
        "import ffsms_pin as f; s = f.load('planar_3r'); s.at(s.configuration([0, 0, 0])).coupling"
    ),
    "import ffsms_pin.opt": "import ffsms_pin.opt",
    "first plan": (
        "import ffsms_pin as f; s = f.load('planar_3r'); q0 = s.configuration([0.4, 0.7, -0.5]); "
        "f.opt.plan(s, q0, [0.7, 0.5, 0.0], duration=4.0, dt=0.02)"
    ),
}
BASE = "import pinocchio, numpy"


def run(repeats: int = 15) -> dict[str, Any]:
    """Return times of whole processes, run alternately, and ratios to importing Pinocchio and NumPy."""
    samples: dict[str, list[float]] = {name: [] for name in PROGRAMS}
    # Byte code is cached, as for an installed package, even if the environment forbids caches.
    with tempfile.TemporaryDirectory() as cache:
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = cache
        for k in range(repeats + 1):
            for name, code in PROGRAMS.items():
                begin = time.perf_counter()
                subprocess.run([sys.executable, "-c", code], check=True, env=environment)
                if k > 0:  # the first repeat fills the cache
                    samples[name].append(time.perf_counter() - begin)
    found = {name: times(values) for name, values in samples.items()}
    ratios = {name: found[name]["median"] / found[BASE]["median"] for name in PROGRAMS}
    return {"repeats": repeats, "times": found, "ratios": ratios}


if __name__ == "__main__":
    print(table.startup(run()))
