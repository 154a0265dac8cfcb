"""The compiled kernel: what plans, steps and batches compute of the robot at stacks of configurations.

Its headers are C++17 on their own; `kernel` is the module that Python sees. It takes arrays of float64,
components first, the stack of configurations last: a function of stacks takes (components, ...) and returns
(components, B), which the caller reshapes.
"""

from __future__ import annotations

from ffsms_pin.kernel import _kernel as kernel

__all__ = ["kernel"]
