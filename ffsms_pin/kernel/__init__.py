"""The compiled kernel: what plans, steps and batches compute of the robot at stacks of configurations.

Its headers are C++17 on their own; `kernel` is the module that Python sees. It takes arrays (components, B)
of float64, the stack of B configurations last, and writes into arrays that it is given.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import _kernel as kernel

__all__ = ["kernel", "rows"]


def rows(values: FloatArray, count: int) -> FloatArray:
    """Values (..., *stack) as the kernel takes them: `count` rows, one after the other in memory."""
    return np.ascontiguousarray(values, dtype=np.float64).reshape(count, -1)
