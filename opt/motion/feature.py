"""Values of motions that carry their own slopes: a part is then one formula, without derivatives by hand.

Forward differentiation by whole arrays: a slope by each of what moves.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, SupportsIndex, TypeAlias

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.errors import InvalidValue

# Slopes by what moves, or what makes them once they are wanted.
Slopes: TypeAlias = "dict[str, FloatArray] | Callable[[], dict[str, FloatArray]]"
# Motions, or None for all of them, and instants.
Where: TypeAlias = "tuple[Indices | None, Any]"

# Components of these each depend on their own joint alone, so their slopes need no axis of their own.
OWN = {"own_joint": "by_joints", "own_rate": "by_rates", "own_acceleration": "by_accelerations"}
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
_lost = threading.local()  # how many features were made plain arrays, in each thread
_TINY = 1e-150  # a root's slope stays finite at zero

# By each of a function's arguments, of its result y and of these; None: one.
_DERIVATIVES: dict[np.ufunc, tuple[Callable[..., Any], ...]] = {
    np.add: (lambda y, a, b: None, lambda y, a, b: None),
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
_FLAT = _COMPARISONS | {np.sign, np.floor, np.ceil, np.isfinite, np.isnan}


def watched(make: Callable[[], Any]) -> tuple[Any, bool]:
    """What a function makes, and whether a feature was made a plain array on the way: its slopes are lost."""
    before, _lost.count = getattr(_lost, "count", 0), 0
    try:
        return make(), _lost.count > 0
    finally:
        _lost.count = before


def _operators(ufunc: np.ufunc) -> tuple[Callable[[Any, Any], Feature], ...]:
    """An operator and its reflection: numpy's own way to `__array_ufunc__` takes half as long again."""
    return (
        lambda x, y: x.__array_ufunc__(ufunc, "__call__", x, y),
        lambda x, y: x.__array_ufunc__(ufunc, "__call__", y, x),
    )


class Feature(NDArrayOperatorsMixin):
    """A number, or a vector, at every instant of every motion, with its slopes by whatever moves it.

    Numbers, vectors (3,) and numpy's functions of single numbers (`np.sqrt`, `np.maximum`, ...) may be used
    with it as with an array, and matrices (r, c) with a vector: `A @ feature`. `.value` is the plain array.

    Parameters
    ----------
    value : ndarray, shape (S, K), or (c, S, K)
        At K instants of S motions; components come first.
    slopes : dict of str to ndarray, or a function that makes it
        The derivatives, each by one quantity while all others are held still: the value's components first,
        if any, then those of the quantity, then S and K, or 1 in their place. A function is called once,
        where slopes are wanted. The names:

        "by_joints", "by_rates", "by_accelerations" (n): joint positions, rates and accelerations;
        "own_joint", "own_rate", "own_acceleration" (no axis): the same of component j by joint j alone;
        "by_tip", "by_turn", "by_velocity", "by_spin" (3): position of the end effector, a turn of it
        (rotation vector), its velocity and angular velocity, inertial axes;
        "by_base", "by_base_turn", "by_base_spin" (3): position of the base's centre of mass, a turn of the
        base, and its angular velocity;
        "by_entropy" (no axis): H_norm; "by_coupling" (6, n): the entries of C_bm in base axes;
        "by_time" (no axis): the time, for what moves by itself, in single steps.
    where : tuple of ndarray, optional
        Motions and instants, (V,) each, of the V values of one of shape (1, V) or (c, 1, V); or None and the
        instants (K,) of all motions. Default: all.
    over_time : bool
        Whether its square, as a residual, is integrated over time; otherwise it counts as it is.
    """

    def __init__(
        self,
        value: FloatArray,
        slopes: Slopes | None = None,
        where: Where | None = None,
        over_time: bool = True,
    ) -> None:
        self.value, self.where, self.over_time = value, where, over_time
        self._slopes: Slopes = {} if slopes is None else slopes

    def __repr__(self) -> str:
        return f"Feature{self.value.shape} moved by {', '.join(self.slopes) or 'nothing'}"

    @property
    def slopes(self) -> dict[str, FloatArray]:
        """By what moves it."""
        if callable(self._slopes):
            self._slopes = dict(self._slopes())
        return self._slopes

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the value."""
        return self.value.shape

    @property
    def ndim(self) -> int:
        """2 of a number, 3 of a vector."""
        return self.value.ndim

    def __len__(self) -> int:
        return len(self.value)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        if self._slopes:
            _lost.count = getattr(_lost, "count", 0) + 1
        return np.array(self.value, dtype=dtype, copy=copy)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if ufunc is np.matmul and not isinstance(inputs[0], Feature):
            matrix = np.asarray(inputs[0])
            return self._linear(lambda x: np.asarray(np.einsum("rc,c...->r...", matrix, x)))
        rules = _DERIVATIVES.get(ufunc)
        if rules is None or method != "__call__" or options:
            flat = ufunc in _FLAT
            plain = [(x.value if flat else np.asarray(x)) if isinstance(x, Feature) else x for x in inputs]
            return getattr(ufunc, method)(*plain, **options)
        features = [(x, rule) for x, rule in zip(inputs, rules, strict=True) if isinstance(x, Feature)]
        moving = [(x, rule) for x, rule in features if x._slopes]
        values = [x.value if isinstance(x, Feature) else _components(x) for x in inputs]
        result = ufunc(*values)

        def slopes() -> dict[str, FloatArray]:
            found: dict[str, FloatArray] = {}
            for x, rule in moving:
                part, joins = rule(result, *values), result.ndim > x.value.ndim
                spreads = result.shape[:-2] != x.value.shape[:-2]  # a number goes into all components
                for name, slope in x.slopes.items():
                    if joins:
                        slope = slope[None]
                    if part is not None:
                        slope = slope * _beside(part, slope.ndim - 3)
                    if spreads and len(slope) < len(result):
                        slope = np.broadcast_to(slope, (len(result), *slope.shape[1:]))
                    _add(found, name, slope)
            return found

        where = features[0][0].where or features[-1][0].where
        return Feature(result, slopes if moving else None, where)

    __add__, __radd__ = _operators(np.add)
    __sub__, __rsub__ = _operators(np.subtract)
    __mul__, __rmul__ = _operators(np.multiply)
    __truediv__, __rtruediv__ = _operators(np.divide)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple) or index is None or index is Ellipsis:
            return np.asarray(self)[index]
        if self.value.ndim < 3:
            raise InvalidValue("index", index, "must be of a vector, and this feature is a number")
        return self._linear(lambda x: x[index])

    def _linear(self, mapping: Callable[[FloatArray], FloatArray]) -> Feature:
        """What a linear function of its components makes of a vector."""

        def slopes() -> dict[str, FloatArray]:
            return {name: mapping(slope) for name, slope in self.by_all().items()}

        return Feature(mapping(self.value), slopes, self.where)

    def by_all(self) -> dict[str, FloatArray]:
        """Slopes, of which none is of components by their own joint alone."""
        found = {name: slope for name, slope in self.slopes.items() if name not in OWN}
        own = {OWN[name]: slope for name, slope in self.slopes.items() if name in OWN}
        return _summed(found, {name: np.eye(len(self))[..., None, None] * own[name] for name in own})

    def sum(self, axis: SupportsIndex | None = 0, **_: Any) -> Feature:
        """Of a vector's components, a number."""
        if axis != 0 or self.value.ndim < 3:
            raise InvalidValue("axis", axis, "must be 0, of a vector: a feature adds up its components only")
        return self._linear(lambda x: x.sum(axis=0))

    def during(self, span: slice) -> Feature:
        """The same at some of its instants, one after the other; of all motions."""

        def slopes() -> dict[str, FloatArray]:  # those that are alike at all times as they are
            return {name: x if x.shape[-1] == 1 else x[..., span] for name, x in self.slopes.items()}

        instants = np.arange(self.value.shape[-1]) if self.where is None else self.where[1]
        return Feature(self.value[..., span], slopes, (None, instants[span]))

    def dot(self, other: Any) -> Feature:
        """Scalar product with a vector (3,), or with another feature."""
        mine, its = self.value, _components(other)

        def slopes() -> dict[str, FloatArray]:
            found = self._along(its)
            return _summed(found, other._along(mine)) if isinstance(other, Feature) else found

        return Feature(np.einsum("c...,c...->...", mine, its), slopes, self.where)

    def _along(self, ways: FloatArray) -> dict[str, FloatArray]:
        """Slopes of the sum of components times ways (c, S, K)."""

        def along(slope: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("c...,c...->...", slope, _beside(ways, slope.ndim - 3)))

        return {name: along(slope) for name, slope in self.by_all().items()}

    def cosine(self, other: Feature, size: FloatArray, its: FloatArray) -> Feature:
        """Cosine of the angle to another vector; lengths (S, K) of both, rounded so that none is zero."""
        here, there = self.value / size, other.value / its
        cosine = np.einsum("c...,c...->...", here, there)

        def slopes() -> dict[str, FloatArray]:
            mine = self._along((there - cosine * here) / size)
            return _summed(mine, other._along((here - cosine * there) / its))

        return Feature(cosine, slopes, self.where)

    def cross(self, other: Any) -> Feature:
        """Vector product with a vector (3,), or with another feature."""
        other = other if isinstance(other, Feature) else np.asarray(other)
        result: Feature = self[_NEXT] * other[_AFTER] - self[_AFTER] * other[_NEXT]
        return result

    def norm(self, rounding: float = 1e-9) -> Feature:
        """Length of a vector, sqrt(x . x + rounding^2): its slopes are finite where it is zero, too."""
        size = np.sqrt(np.einsum("csk,csk->sk", self.value, self.value) + rounding * rounding)
        return Feature(size, lambda: self._along(self.value / size), self.where)

    def squares(self, weights: FloatArray, motions: int) -> FloatArray:
        """Sum of its squares (S,), integrated with weights of all instants (K,) where it is over time."""
        motion, instants = self.where or (None, slice(None))
        square: FloatArray = self.value * self.value
        if square.ndim == 3:
            square = square.sum(axis=0)
        if self.over_time:
            square = square * weights[instants]
        if motion is None:
            return np.asarray(square.sum(axis=1))
        return np.bincount(motion, square[0], minlength=motions).astype(np.float64)

    def at_once(self) -> Feature:
        """The same as a residual whose square counts as it is."""
        return Feature(self.value, lambda: self.slopes, self.where, over_time=False)


def root_of_size(x: Feature, rounding: float) -> Feature:
    """What squares to the size of x, smooth at zero: r^2 = sqrt(x^2 + e^2) - e, at most e less than |x|.

    Least squares take squares, and the integral of |x| has a kink at zero. With s = sqrt(x^2 + e^2) it is
    (s - e)(s + e) = x^2, so r = x / sqrt(s + e).
    """
    return x / np.sqrt(np.hypot(x, rounding) + rounding)


def _add(found: dict[str, FloatArray], name: str, slope: FloatArray) -> None:
    found[name] = found[name] + slope if name in found else slope


def _summed(found: dict[str, FloatArray], others: dict[str, FloatArray]) -> dict[str, FloatArray]:
    for name, slope in others.items():
        _add(found, name, slope)
    return found


def _components(x: Any) -> Any:
    """What meets (c, S, K): a number, or a plain array; vectors (c,) get the axes that they lack."""
    if isinstance(x, (Feature, float)):
        return x.value if isinstance(x, Feature) else x
    array = np.asarray(x, dtype=np.float64)
    return array[:, None, None] if array.ndim == 1 else array


def _beside(values: Any, moved: int) -> Any:
    """Values (c, S, K) with so many axes, of what moves, behind the first; others as they are."""
    if not moved or getattr(values, "ndim", 0) < 3:
        return values
    return values.reshape(len(values), *(1,) * moved, *values.shape[1:])
