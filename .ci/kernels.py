"""Run a short sample of the trials and some plans with each OpenBLAS kernel that is not the default.

OpenBLAS chooses its kernel by the processor. The last bits of a decomposition, and its convergence, depend on
the kernel. `make test` uses the default kernel. `OPENBLAS_CORETYPE` selects another kernel. A kernel with
several names is run once.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# NumPy requires the instructions of Nehalem. Its kernel stands for all older than Haswell's.
CANDIDATES = ("Nehalem", "Haswell", "Zen", "SkylakeX", "Cooperlake")
CANDIDATES += ("Sapphirerapids", "ARMV8", "NEOVERSEN1", "NEOVERSEV1", "VORTEX")
# This program prints the kernels of NumPy and SciPy; it fails if the processor lacks a kernel's instructions.
PROBE = """
import numpy as np, scipy.linalg
from threadpoolctl import threadpool_info
A = np.random.default_rng(0).normal(size=(60, 60))
B = A @ A.T
for values, vectors in (np.linalg.eigh(B), scipy.linalg.eigh(B)):
    assert np.allclose(vectors * values @ vectors.T, B)
U, sigma, Vt = np.linalg.svd(A)
assert np.allclose(U * sigma @ Vt, A) and np.allclose(A @ np.linalg.solve(A, B), B)
print(*sorted({lib["architecture"] for lib in threadpool_info() if lib["internal_api"] == "openblas"}))
"""
COMMANDS = (
    (sys.executable, "-m", "trials", "urdfs", "scenarios", "calls", "--share", "0.01"),
    (sys.executable, "-m", "pytest", "-q", "-n", "0", "tests/opt/planning/test_plan.py",
     "tests/opt/planning/test_pose.py"),
)  # fmt: skip


def main() -> int:
    """Print the result of each kernel, and return the exit status, 1 if a kernel failed."""
    begun, kernels = time.monotonic(), usable_kernels()
    print(f"{kernels.pop('')}: left out, because `make test` uses this kernel")
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = list(pool.map(run, kernels))
    for (name, kernel), (seconds, output) in zip(kernels.items(), results, strict=True):
        outcome = f"{'failed' if output else 'passed'} in {seconds:.0f} s (OPENBLAS_CORETYPE={name})"
        print(f"{kernel}: {outcome}\n{output}", end="")
    print(f"{len(kernels)} runs in {time.monotonic() - begun:.0f} s")
    return 1 if any(output for _, output in results) else 0


def usable_kernels() -> dict[str, str]:
    """Return values of OPENBLAS_CORETYPE with their kernels, each kernel once; "" is the default."""
    kernels = {"": probed("")}
    for name in CANDIDATES:
        if (kernel := probed(name)) and kernel not in kernels.values():
            kernels[name] = kernel
    return kernels


def probed(name: str) -> str:
    """Return the kernels that NumPy and SciPy use for a name; "" if the processor cannot run one of them."""
    done = subprocess.run(
        [sys.executable, "-c", PROBE], env=environment(name), capture_output=True, text=True, check=False
    )
    return done.stdout.strip() if done.returncode == 0 else ""


def run(name: str) -> tuple[float, str]:
    """Run all commands, and return their time [s] and the output of failed commands."""
    begun, output = time.monotonic(), ""
    for command in COMMANDS:
        done = subprocess.run(
            command, cwd=ROOT, env=environment(name), capture_output=True, text=True, check=False
        )
        output += done.stdout + done.stderr if done.returncode else ""
    return time.monotonic() - begun, output


def environment(name: str) -> dict[str, str]:
    """Return this process's environment for a kernel, with one thread and with the tests on the path."""
    own = {key: value for key, value in os.environ.items() if key != "OPENBLAS_CORETYPE"}
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    return own | {"OMP_NUM_THREADS": "1", "PYTHONPATH": path} | ({"OPENBLAS_CORETYPE": name} if name else {})


if __name__ == "__main__":
    sys.exit(main())
