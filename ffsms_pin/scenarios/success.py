"""The confidence interval of a success rate."""

from __future__ import annotations

import math

from ffsms_pin.checks import whole
from ffsms_pin.errors import InvalidValue

__all__ = ["wilson_interval"]

_Z = 1.959963984540054  # of the standard normal distribution: 95 % lie within


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """95 % confidence interval of a success rate.

    Parameters
    ----------
    successes, runs : int
        runs at least 1.

    Returns
    -------
    low, high : float
        Within 0 and 1, also where none or all succeed.

    References
    ----------
    E. B. Wilson, Probable inference, the law of succession, and statistical inference, J. Am. Stat. Assoc.
    22 (1927) 209-212: (p + z^2/2n -+ z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n).
    """
    successes, runs = whole("successes", successes, 0), whole("runs", runs, 1)
    if successes > runs:
        raise InvalidValue("successes", successes, f"must not exceed the {runs} runs")
    p, square = successes / runs, _Z**2 / runs
    middle = (p + 0.5 * square) / (1.0 + square)
    half = _Z / (1.0 + square) * math.sqrt(p * (1.0 - p) / runs + 0.25 * square / runs)
    low = 0.0 if successes == 0 else middle - half
    return low, 1.0 if successes == runs else middle + half
