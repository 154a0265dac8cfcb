"""Tabulate numbers of the packaged scenarios from the summaries that `ffsms-pin run NAME` writes.

Run from the repository's root: python benchmarks/packaged.py case-1 case-2
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from functools import reduce
from pathlib import Path
from typing import Any

from table import markdown

# The label of a row, its key in summary.json, and the factor of its unit.
ROWS = (
    ("final error of the plan [mm]", "final_error_m", 1e3),
    ("cost integral [s]", "cost_integral_s", 1.0),
    ("largest base rotation [deg]", "base.rotation_max_deg", 1.0),
    ("largest joint error in the simulation [mrad]", "tracking.joint_error_max_rad", 1e3),
    ("final error in the simulation [mm]", "tracking.final_error_m", 1e3),
    ("largest total linear momentum [kg m/s]", "tracking.momentum_linear_max_kg_m_per_s", 1.0),
    ("largest total angular momentum [kg m^2/s]", "tracking.momentum_angular_max_kg_m2_per_s", 1.0),
    ("energy minus work of the torques, relative", "tracking.energy_error_relative", 1.0),
)


def summary(name: str) -> Any:
    """Run a scenario, and return its summary.json. A run that does not arrive (status 1) writes it, too."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "ffsms_pin", "run", name, "--no-figures", "--out", folder]
        status = subprocess.run(command, capture_output=True, check=False).returncode
        if status > 1:
            raise SystemExit(f"ffsms-pin run {name} ended with status {status}")
        return json.loads((Path(folder) / "summary.json").read_text("utf-8"))


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+")
    names = parser.parse_args().names
    found = [summary(name) for name in names]
    rows = [
        (what, *(f"{factor * reduce(dict.__getitem__, where.split('.'), one):.2g}" for one in found))
        for what, where, factor in ROWS
    ]
    print(markdown(("", *(f"`{name}`" for name in names)), rows))


if __name__ == "__main__":
    main()
