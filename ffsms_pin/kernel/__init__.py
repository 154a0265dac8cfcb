"""The compiled kernel: what plans, steps and batches compute of the robot at stacks of configurations.

Its headers are C++17 on their own; `kernel` is the module that Python sees. It takes arrays of float64,
components first, the stack of configurations last: a function of stacks takes (components, ...) and returns
(components, B), which the caller reshapes. For processors with AVX2 the same sources are compiled once more,
where the compiler can: the same bits in less time.
"""

from __future__ import annotations

from pathlib import Path

try:
    from numpy._core._multiarray_umath import __cpu_features__ as instructions  # type: ignore[import-not-found]
except ImportError:  # NumPy 1
    instructions = {}
if instructions.get("AVX2"):
    __path__.insert(0, str(Path(__file__).with_name("avx2")))

from ffsms_pin.kernel import _kernel as kernel

__all__ = ["instructions", "kernel"]
