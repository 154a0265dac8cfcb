"""Run a short sample of the trials and some plans under each OpenBLAS kernel of this processor.

OpenBLAS picks its kernel by the processor, so last bits, and whether a decomposition converges, depend on the
machine. `OPENBLAS_CORETYPE` picks another kernel; names that lead to the same kernel are run once.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CANDIDATES = ("Prescott", "Nehalem", "Sandybridge", "Haswell", "Zen", "SkylakeX", "Cooperlake")
CANDIDATES += ("Sapphirerapids", "ARMV8", "NEOVERSEN1", "NEOVERSEV1", "VORTEX")
# It fails on a processor without the kernel's instructions; else it prints the kernels of NumPy and SciPy.
PROBE = """
import numpy as np, scipy.linalg
from threadpoolctl import threadpool_info
A = np.random.default_rng(0).normal(size=(60, 60))
B = A @ A.T
for found in (np.linalg.eigh(B), scipy.linalg.eigh(B)):
    assert np.allclose(found[1] * found[0] @ found[1].T, B)
U, sigma, Vt = np.linalg.svd(A)
assert np.allclose(U * sigma @ Vt, A) and np.allclose(A @ np.linalg.solve(A, B), B)
print(*sorted({one["architecture"] for one in threadpool_info() if one["internal_api"] == "openblas"}))
"""
COMMANDS = (
    (sys.executable, "-m", "trials", "urdfs", "scenarios", "calls", "--share", "0.01"),
    (sys.executable, "-m", "pytest", "-q", "-n", "0", "tests/opt/planning/test_plan.py",
     "tests/opt/planning/test_pose.py"),
)  # fmt: skip


def main() -> int:
    """Print a table of the kernels and their results; the exit status is 1 if one failed."""
    begun, kernels = time.monotonic(), usable_kernels()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(pool.map(run, kernels.values()))
    for (kernel, name), (seconds, output) in zip(kernels.items(), results, strict=True):
        choice = f"OPENBLAS_CORETYPE={name}" if name else "OPENBLAS_CORETYPE unset"
        print(f"{kernel}: {'failed' if output else 'passed'} in {seconds:.0f} s ({choice})\n{output}", end="")
    print(f"{len(kernels)} runs in {time.monotonic() - begun:.0f} s")
    return 1 if any(output for _, output in results) else 0


def usable_kernels() -> dict[str, str]:
    """Return the value of OPENBLAS_CORETYPE for each kernel that works here; "" for the default kernel."""
    found = {probed(""): ""}
    for name in CANDIDATES:
        if kernel := probed(name):
            found.setdefault(kernel, name)
    return found


def probed(name: str) -> str:
    """Return the kernels that NumPy and SciPy use under a name; empty if the processor lacks one."""
    done = subprocess.run(
        [sys.executable, "-c", PROBE], env=environment(name), capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else ""


def run(name: str) -> tuple[float, str]:
    """Return the time that all commands take [s], and the output of those that fail."""
    begun, output = time.monotonic(), ""
    for command in COMMANDS:
        done = subprocess.run(
            command, cwd=ROOT, env=environment(name), capture_output=True, text=True, check=False
        )
        output += done.stdout + done.stderr if done.returncode else ""
    return time.monotonic() - begun, output


def environment(name: str) -> dict[str, str]:
    """Return this process's environment with a kernel chosen, one thread, and the tests importable."""
    own = {key: value for key, value in os.environ.items() if key != "OPENBLAS_CORETYPE"}
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    return own | {"OMP_NUM_THREADS": "1", "PYTHONPATH": path} | ({"OPENBLAS_CORETYPE": name} if name else {})


if __name__ == "__main__":
    sys.exit(main())
