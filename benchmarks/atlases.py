"""Processor time and memory of whole `ffsms-pin atlas` commands: `python benchmarks/atlases.py`."""

from __future__ import annotations

import tempfile
from pathlib import Path

from table import markdown
from timing import command

ATLASES = (  # each with the number of processes
    ("planar_3r", 10_000_000, 1),
    ("satellite_panda", 1_000_000, 1),
    ("satellite_panda", 4_000_000, 1),
    ("planar_3r", 10_000_000, 2),
    ("satellite_panda", 4_000_000, 2),
)


def measured(name: str, samples: int, jobs: int, folder: Path) -> tuple[str, ...]:
    """One line of the table."""
    out = folder / f"{name}-{samples}-{jobs}.zarr"
    words = ["atlas", name, "--samples", str(samples), "--jobs", str(jobs)]
    cost = command([*words, "--out", str(out)])
    size = sum(file.stat().st_size for file in [out, *out.rglob("*")] if file.is_file())
    return (
        f"`{' '.join(words)}`",
        f"{cost.used:.0f} s",
        f"{cost.clock:.0f} s",
        f"{cost.memory:.0f} MB",
        f"{size / 1e6:.0f} MB",
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        lines = [measured(*one, Path(name)) for one in ATLASES]
    head = ("atlas", "processor time", "by the clock", "memory of the process, largest", "file")
    print(markdown(head, lines))
