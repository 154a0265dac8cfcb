"""Measure the error of the total momentum during a capture and the minute after it.

Run from the repository's root: python benchmarks/ledger.py [--after 60]
The packaged `capture` is simulated without noise and planned once, with and without wheels that hold the
attitude. The table has the largest change of the momentum of arm, base, wheels and client together, as a
share of the larger of the momenta of servicer and client at the start. No external force acts.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import ffsms_pin.scenarios as scenarios
from ffsms_pin.scenarios.definition import packaged_path

WHEELS = """
[wheels]
axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
inertia = 0.05
momentum = 30.0
torque = 1.0
[attitude]
"""
METHODS = ("rk4", "variational")


def made(after: float, method: str, wheels: bool) -> str:
    """Return the text of the scenario file."""
    text = packaged_path("capture").read_text("utf-8")
    for name in ("[client.sensor]", "[reference]"):  # exact measurements, and one plan
        begin = text.index(name)
        text = text[:begin] + text[text.index("\n[", begin) + 1 :]
    text = text.replace("after = 10.0", f"after = {after}") + f'\n[simulation]\nintegrator = "{method}"\n'
    if not wheels:
        return text
    return text.replace("[plan]", '[plan]\nmode = "rotation-floating"', 1) + WHEELS


def flown(text: str) -> Any:
    """Simulate the scenario, and return its capture."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.toml"
        path.write_text(text, encoding="utf-8")
        return scenarios.run(scenarios.scenario(path)).capture


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--after", type=float, default=60.0, help="seconds simulated after the capture")
    after = parser.parse_args().after
    print("| integrator | wheels | caught | relative error of the momentum | energy minus work [J] |")
    print("|---|---|---|---|---|")
    for method in METHODS:
        for wheels in (False, True):
            capture = flown(made(after, method, wheels))
            energy = abs(capture.whole.energy_error).max()
            row = method, "hold" if wheels else "none", "yes" if capture.caught else "no"
            print("|", " | ".join(row), f"| {capture.momentum_error:.1e} | {energy:.1e} |", flush=True)


if __name__ == "__main__":
    main()
