"""The packaged `nozzle` with other plants, other noise: how often the probe is latched, and what it costs.

Run from the repository's root: python benchmarks/nozzle.py [--seeds 100] [--first 0]
A seed draws the plant's masses and inertias, the noise of the sensors and that of the camera; all else is as
packaged, but for the time after the catch. Every run that does not latch says why.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin import scenarios
from ffsms_pin.errors import FfsmsError
from ffsms_pin.scenarios.file import packaged_path


def flown(seed: int) -> dict[str, Any]:
    """What became of one seed."""
    text = re.sub(r"(?m)^after = .*$", "after = 2.0", packaged_path("nozzle").read_text("utf-8"))
    text = text.replace("[plant.random]\nseed = 1", f"[plant.random]\nseed = {seed}")
    for table in ("[client.sensor]", "[sensors]"):
        text = text.replace(table, f"{table}\nseed = {seed}")
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nozzle.toml"
        path.write_text(text, encoding="utf-8")
        try:
            found = scenarios.run(scenarios.scenario(path)).capture
        except FfsmsError as error:
            return {"caught": False, "why": str(error)}
    assert found is not None
    forces = np.linalg.norm(found.whole.contact_wrench[found.whole.t < found.latched_at - 1e-6, :3], axis=1)
    guided = forces[found.whole.t[: len(forces)] < found.contact_at - 1e-6]
    return {
        "caught": found.caught,
        "why": found.missed,
        "guide": float(guided.max(initial=0.0)),
        "force": float(forces.max(initial=0.0)),
        "torque": float((np.abs(found.whole.tau) / found.limits).max()),
        "cpu": time.process_time() - began,
    }


def main() -> None:
    """Print every run, and a line of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        rows.append(row := flown(seed))
        if row["caught"]:
            loads = f"{row['guide']:.1f} N in the guide, {row['force']:.1f} N at most"
            print(
                f"{seed}: latched, {loads}, {row['torque']:.2f} of a torque, {row['cpu']:.0f} s", flush=True
            )
        else:
            print(f"{seed}: {row['why']}", flush=True)
    caught = [row for row in rows if row["caught"]]
    print(f"\n{len(caught)} of {len(rows)} latched")
    for name in ("guide", "force", "torque", "cpu") if caught else ():
        values = [row[name] for row in caught]
        print(f"{name}: {np.median(values):.3g} in the median, {max(values):.3g} at most")


if __name__ == "__main__":
    main()
