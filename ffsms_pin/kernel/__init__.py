"""The compiled kernel: kinematics, dynamics and distances of a robot at many configurations.

`kernel` is the compiled module. Its headers are C++17, and only `arrays.hpp` depends on Python. Functions of
`module.cpp` take arrays (components, ...) of float64 and return arrays (components, B), which the caller
reshapes. If the compiler supports AVX2, the same sources are compiled a second time for processors with AVX2;
both versions return identical bits.
"""

from __future__ import annotations

from pathlib import Path

try:
    from numpy._core._multiarray_umath import __cpu_features__ as instructions  # type: ignore[import-not-found]
except ImportError:  # NumPy 1 has no `numpy._core`
    instructions = {}
if instructions.get("AVX2"):
    __path__.insert(0, str(Path(__file__).with_name("avx2")))

from ffsms_pin.kernel import _kernel as kernel

__all__ = ["instructions", "kernel"]
