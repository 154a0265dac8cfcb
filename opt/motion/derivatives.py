"""Derivatives of numpy's functions of numbers, by each of their arguments: of the result y and of these."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["DERIVATIVES", "FLAT"]

_TINY = 1e-150  # a root's slope stays finite at zero

DERIVATIVES: dict[np.ufunc, tuple[Callable[..., Any], ...]] = {
    np.add: (lambda y, a, b: None, lambda y, a, b: None),  # None: one
    np.subtract: (lambda y, a, b: None, lambda y, a, b: -1.0),
    np.multiply: (lambda y, a, b: b, lambda y, a, b: a),
    np.divide: (lambda y, a, b: 1.0 / b, lambda y, a, b: -y / b),
    np.power: (lambda y, a, b: b * a ** (b - 1.0), lambda y, a, b: y * np.log(a)),
    np.hypot: (lambda y, a, b: a / (y + _TINY), lambda y, a, b: b / (y + _TINY)),
    np.arctan2: (lambda y, a, b: b / (a * a + b * b), lambda y, a, b: -a / (a * a + b * b)),
    np.maximum: (lambda y, a, b: np.where(a >= b, 1.0, 0.0), lambda y, a, b: np.where(a >= b, 0.0, 1.0)),
    np.minimum: (lambda y, a, b: np.where(a <= b, 1.0, 0.0), lambda y, a, b: np.where(a <= b, 0.0, 1.0)),
    np.logaddexp: (lambda y, a, b: np.exp(a - y), lambda y, a, b: np.exp(b - y)),
    np.negative: (lambda y, a: -1.0,),
    np.positive: (lambda y, a: None,),
    np.absolute: (lambda y, a: np.sign(a),),
    np.sqrt: (lambda y, a: 0.5 / (y + _TINY),),
    np.square: (lambda y, a: 2.0 * a,),
    np.exp: (lambda y, a: y,),
    np.log: (lambda y, a: 1.0 / a,),
    np.sin: (lambda y, a: np.cos(a),),
    np.cos: (lambda y, a: -np.sin(a),),
    np.tan: (lambda y, a: 1.0 + y * y,),
    np.tanh: (lambda y, a: 1.0 - y * y,),
    np.arcsin: (lambda y, a: 1.0 / np.sqrt(1.0 - a * a),),
    np.arccos: (lambda y, a: -1.0 / np.sqrt(1.0 - a * a),),
    np.arctan: (lambda y, a: 1.0 / (1.0 + a * a),),
}

# What does not change by a little: no slopes are lost there.
_COMPARISONS = {np.equal, np.not_equal, np.less, np.less_equal, np.greater, np.greater_equal}
FLAT = frozenset(_COMPARISONS | {np.sign, np.floor, np.ceil, np.isfinite, np.isnan})
