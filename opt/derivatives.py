"""Variables of motions with their derivatives (forward mode), for the formulas of terms and limits.

A `Variable` is an array with slopes, its derivatives with respect to the quantities on which it depends. A
`FrameVariable` is the position of a frame of the robot, with the frame's attitude. `Variables` has all
variables of whole motions, and `StepVariables` has the variables of a single step.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsIndex, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.lib.mixins import NDArrayOperatorsMixin

from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.errors import InvalidValue
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.rollouts import (
    FixedRollouts,
    Rollouts,
    apply_rates,
    coupling_slopes,
    force_slopes,
    held_momentum,
    momentum_force_slopes,
    wheel_shares,
)
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot, exp3, log3, skew
from ffsms_pin.system.mechanism import frame_index

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

# Slopes by quantity, or a function that computes them when they are needed.
Slopes: TypeAlias = "dict[str, FloatArray] | Callable[[], dict[str, FloatArray]]"
# Indices of motions, or None for all motions, and indices of instants.
Where: TypeAlias = "tuple[Indices | None, Any]"

# Slopes of component j with respect to joint j alone, which have no axis for joints, and the names of the
# same slopes with respect to all joints.
OWN = {"own_joint": "by_joints", "own_rate": "by_rates", "own_acceleration": "by_accelerations"}
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
_lost = threading.local()  # number of conversions of variables with slopes to plain arrays, by thread
_TINY = 1e-150  # keeps the slopes of square root and hypot finite at zero

# Derivatives of a function by each argument, computed from its result y and its arguments; None means 1.
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

# Functions with piecewise constant results, whose slopes are zero.
_COMPARISONS = {np.equal, np.not_equal, np.less, np.less_equal, np.greater, np.greater_equal}
_FLAT = _COMPARISONS | {np.sign, np.floor, np.ceil, np.isfinite, np.isnan}


def gradient_watch(make: Callable[[], Any]) -> tuple[Any, bool]:
    """Call a function; return its result, and True if a variable with slopes became a plain array."""
    before, _lost.count = getattr(_lost, "count", 0), 0
    try:
        return make(), _lost.count > 0
    finally:
        _lost.count = before


def _operators(ufunc: np.ufunc) -> tuple[Callable[[Any, Any], Variable], ...]:
    """Return a binary operator and its reflection, which bypass NumPy's dispatch for speed."""
    return (
        lambda x, y: x.__array_ufunc__(ufunc, "__call__", x, y),
        lambda x, y: x.__array_ufunc__(ufunc, "__call__", y, x),
    )


class Variable(NDArrayOperatorsMixin):
    """A number or a vector at every instant of every motion, with its derivatives.

    Operators and NumPy's elementwise functions (`np.sqrt`, `np.maximum`, ...) combine variables with numbers,
    vectors (c,) and other variables. `A @ variable` multiplies a vector by a matrix (r, c). The attribute
    `value` is the plain array.

    Parameters
    ----------
    value : ndarray, shape (S, K), or (c, S, K)
        The value at K instants of S motions; components come first.
    slopes : dict of str to ndarray, or a function that returns such a dict
        The partial derivatives, by the names below. The axes of a slope are the components of the value if it
        is a vector, then the axes of the quantity, then S and K. The axes S and K may have the length 1, and
        in the "own" slopes also the axis of components. A function that returns the slopes is called once,
        when they are needed. The names are:

        "by_joints", "by_rates", "by_accelerations" (n): joint positions, rates and accelerations;
        "own_joint", "own_rate", "own_acceleration" (no axis): derivatives of component j by joint j alone;
        "by_tip", "by_turn", "by_velocity", "by_spin" (3): the end effector's position, rotation vector,
        velocity and angular velocity, inertial axes;
        "by_base", "by_base_turn", "by_base_spin" (3): the position of the base's centre of mass, the base's
        rotation vector and its angular velocity, inertial axes;
        "by_entropy" (no axis): H_norm; "by_coupling" (6, n): the entries of C_bm in base axes;
        "by_time" (no axis): the time, for a variable of a single step that depends on time explicitly.
    where : tuple of ndarray, optional
        Indices (V,) of motions and (V,) of instants, for V values in shape (1, V) or (c, 1, V); or None and
        indices (K,) of instants of all motions. Default: all motions and instants.
    over_time : bool
        True if the square of a residual is integrated over time, False if it is added without integration.
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
        return f"Variable{self.value.shape} with slopes {', '.join(self.slopes) or 'none'}"

    @property
    def slopes(self) -> dict[str, FloatArray]:
        """The derivatives, by the names of their quantities."""
        if callable(self._slopes):
            self._slopes = dict(self._slopes())
        return self._slopes

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the value."""
        return self.value.shape

    @property
    def ndim(self) -> int:
        """The number of axes: 2 for a number, 3 for a vector."""
        return self.value.ndim

    def __len__(self) -> int:
        return len(self.value)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        if self._slopes:
            _lost.count = getattr(_lost, "count", 0) + 1
        return np.array(self.value, dtype=dtype, copy=copy)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        if ufunc is np.matmul and not isinstance(inputs[0], Variable):
            matrix = np.asarray(inputs[0])
            return self._linear(lambda x: np.asarray(np.einsum("rc,c...->r...", matrix, x)))
        rules = _DERIVATIVES.get(ufunc)
        if rules is None or method != "__call__" or options:
            flat = ufunc in _FLAT
            plain = [(x.value if flat else np.asarray(x)) if isinstance(x, Variable) else x for x in inputs]
            return getattr(ufunc, method)(*plain, **options)
        variables = [(x, rule) for x, rule in zip(inputs, rules, strict=True) if isinstance(x, Variable)]
        moving = [(x, rule) for x, rule in variables if x._slopes]
        values = [x.value if isinstance(x, Variable) else _components(x) for x in inputs]
        result = ufunc(*values)

        def slopes() -> dict[str, FloatArray]:
            by_name: dict[str, FloatArray] = {}
            for x, rule in moving:
                part, joins = rule(result, *values), result.ndim > x.value.ndim
                spreads = result.shape[:-2] != x.value.shape[:-2]  # x is a number and the result a vector
                for name, slope in x.slopes.items():
                    if joins:
                        slope = slope[None]
                    if part is not None:
                        slope = slope * _beside(part, slope.ndim - 3)
                    if spreads and len(slope) < len(result):
                        slope = np.broadcast_to(slope, (len(result), *slope.shape[1:]))
                    _add(by_name, name, slope)
            return by_name

        where = variables[0][0].where or variables[-1][0].where
        return Variable(result, slopes if moving else None, where)

    __add__, __radd__ = _operators(np.add)
    __sub__, __rsub__ = _operators(np.subtract)
    __mul__, __rmul__ = _operators(np.multiply)
    __truediv__, __rtruediv__ = _operators(np.divide)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple) or index is None or index is Ellipsis:
            return np.asarray(self)[index]
        if self.value.ndim < 3:
            raise InvalidValue(
                "index", index, "must be left out, because this variable is a number, not a vector"
            )
        return self._linear(lambda x: x[index])

    def _linear(self, mapping: Callable[[FloatArray], FloatArray]) -> Variable:
        """Apply a linear function to the components of a vector."""

        def slopes() -> dict[str, FloatArray]:
            return {name: mapping(slope) for name, slope in self.by_all().items()}

        return Variable(mapping(self.value), slopes, self.where)

    def by_all(self) -> dict[str, FloatArray]:
        """Return the slopes with an axis for all joints, including the slopes named in `OWN`."""
        by_name = {name: slope for name, slope in self.slopes.items() if name not in OWN}
        own = {OWN[name]: slope for name, slope in self.slopes.items() if name in OWN}
        return _summed(by_name, {name: np.eye(len(self))[..., None, None] * own[name] for name in own})

    def sum(self, axis: SupportsIndex | None = 0, **_: Any) -> Variable:
        """Return the sum of a vector's components, a number."""
        if self.value.ndim < 3:
            remedy = "must be left out, together with sum(), because this variable is a number, not a vector"
            raise InvalidValue("axis", axis, remedy)
        if axis != 0:
            raise InvalidValue("axis", axis, "must be 0, because only the components of a vector are summed")
        return self._linear(lambda x: x.sum(axis=0))

    def during(self, span: slice) -> Variable:
        """Return the variable of all motions at the instants in `span`."""

        def slopes() -> dict[str, FloatArray]:  # arrays that are constant in time stay unchanged
            return {name: x if x.shape[-1] == 1 else x[..., span] for name, x in self.slopes.items()}

        instants = np.arange(self.value.shape[-1]) if self.where is None else self.where[1]
        return Variable(self.value[..., span], slopes, (None, instants[span]))

    def dot(self, other: Any) -> Variable:
        """Return the scalar product with a vector (c,), or with another variable."""
        first, second = self.value, _components(other)

        def slopes() -> dict[str, FloatArray]:
            by_name = self._along(second)
            return _summed(by_name, other._along(first)) if isinstance(other, Variable) else by_name

        return Variable(np.einsum("c...,c...->...", first, second), slopes, self.where)

    def _along(self, directions: FloatArray) -> dict[str, FloatArray]:
        """Return the slopes of the scalar product with constant directions (c, S, K)."""

        def along(slope: FloatArray) -> FloatArray:
            return np.asarray(np.einsum("c...,c...->...", slope, _beside(directions, slope.ndim - 3)))

        return {name: along(slope) for name, slope in self.by_all().items()}

    def cosine(self, other: Variable, size: FloatArray, other_size: FloatArray) -> Variable:
        """Return the cosine of the angle to another vector.

        `size` and `other_size` (S, K) are the lengths of the two vectors, above zero.
        """
        here, there = self.value / size, other.value / other_size
        cosine = np.einsum("c...,c...->...", here, there)

        def slopes() -> dict[str, FloatArray]:
            mine = self._along((there - cosine * here) / size)
            return _summed(mine, other._along((here - cosine * there) / other_size))

        return Variable(cosine, slopes, self.where)

    def cross(self, other: Any) -> Variable:
        """Return the vector product with a vector (3,), or with another variable."""
        other = other if isinstance(other, Variable) else np.asarray(other)
        result: Variable = self[_NEXT] * other[_AFTER] - self[_AFTER] * other[_NEXT]
        return result

    def norm(self, rounding: float = 1e-9) -> Variable:
        """Return the length of a vector, sqrt(x . x + rounding^2), with finite slopes at zero."""
        size = np.sqrt(np.einsum("csk,csk->sk", self.value, self.value) + rounding * rounding)
        return Variable(size, lambda: self._along(self.value / size), self.where)

    def squares(self, weights: FloatArray, motions: int) -> FloatArray:
        """Return the sum of squares (S,), integrated with the weights (K,) if `over_time`."""
        motion, instants = self.where or (None, slice(None))
        square: FloatArray = self.value * self.value
        if square.ndim == 3:
            square = square.sum(axis=0)
        if self.over_time:
            square = square * weights[instants]
        if motion is None:
            return np.asarray(square.sum(axis=1))
        return np.bincount(motion, square[0], minlength=motions).astype(np.float64)

    def at_once(self) -> Variable:
        """Return the variable as a residual whose square is added without integration over time."""
        return Variable(self.value, lambda: self.slopes, self.where, over_time=False)


def root_of_size(x: Variable, rounding: float) -> Variable:
    """Return r with r^2 = sqrt(x^2 + e^2) - e, a smooth |x| that is too small by at most e = `rounding`.

    As a residual, r makes a least-squares problem minimise |x| without the kink at zero. With
    s = sqrt(x^2 + e^2), (s - e)(s + e) = x^2, so r = x / sqrt(s + e).
    """
    return x / np.sqrt(np.hypot(x, rounding) + rounding)


def _add(slopes: dict[str, FloatArray], name: str, slope: FloatArray) -> None:
    slopes[name] = slopes[name] + slope if name in slopes else slope


def _summed(slopes: dict[str, FloatArray], others: dict[str, FloatArray]) -> dict[str, FloatArray]:
    for name, slope in others.items():
        _add(slopes, name, slope)
    return slopes


def _components(x: Any) -> Any:
    """Return x as an array that broadcasts with (c, S, K); vectors (c,) get two more axes."""
    if isinstance(x, (Variable, float)):
        return x.value if isinstance(x, Variable) else x
    array = np.asarray(x, dtype=np.float64)
    return array[:, None, None] if array.ndim == 1 else array


def _beside(values: Any, axes: int) -> Any:
    """Insert `axes` axes behind the first axis of values (c, S, K); return other values unchanged."""
    if not axes or getattr(values, "ndim", 0) < 3:
        return values
    return values.reshape(len(values), *(1,) * axes, *values.shape[1:])


# The axes in which a quantity is expressed.
INERTIAL, BASE = "inertial", "base"
EYE = np.eye(3)[..., None, None]  # slopes of a vector with respect to itself


class RobotFrame(NamedTuple):
    """A frame that is fixed to a body of the robot."""

    moves: FloatArray  # (n,) 1 for joints that move the frame, else 0
    body: int | None = None  # index of the body's joint; -1: the base, None: the frame is the end effector
    offset: FloatArray = np.zeros(3)  # the frame's position in the body's axes [m]
    turn: FloatArray = np.eye(3)  # the frame's attitude in the body's axes

    @classmethod
    def of(cls, stack: ArmStack, name: str = "tip") -> RobotFrame:
        """Return the robot's frame called `name`; "tip" is the end effector.

        An unknown name raises `FrameNotFound`.
        """
        if name in ("tip", stack.robot.end_effector):
            return cls(stack.moves_tip)
        frame = stack.robot.model.frames[frame_index(stack.robot.model, name)]
        body, placement = int(frame.parentJoint) - 2, frame.placement
        moves = stack.carries[:, body] if body >= 0 else np.zeros(stack.n)
        return cls(moves, body, placement.translation.copy(), placement.rotation.copy())

    def of_arm(self, arm: ArmValues) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return position (3, ...) [m], rotation (3, 3, ...), and linear and angular Jacobian (3, n, ...).

        All are relative to the base's root frame, in root axes, for a fixed base.
        """
        shape = arm.axes.shape[2:]
        along = (..., *(None,) * len(shape))
        moves = self.moves[along]
        angular = arm.axes * moves
        if self.body is None:
            return arm.tip, arm.tip_rotation, arm.arm, angular
        if self.body < 0:
            position = np.broadcast_to(self.offset[along], (3, *shape))
            rotation = np.broadcast_to(self.turn[along], (3, 3, *shape))
        else:
            carrier = arm.rotations[:, :, self.body]
            position = arm.points[:, self.body] + np.einsum("xy...,y->x...", carrier, self.offset)
            rotation = np.einsum("xy...,yz->xz...", carrier, self.turn)
        linear = arm.velocities * moves + cross(angular, position[:, None])
        return position, rotation, linear, angular


class FrameVariable(Variable):
    """The position of a frame (3, S, K) [m], as a variable that also has the frame's attitude.

    `rotation` is the attitude (3, 3, S, K), or a function that returns it. `turns` are the slopes of the
    frame's rotation vector. All are in the same axes, inertial or base axes in `Variables`.
    """

    def __init__(
        self,
        position: FloatArray,
        rotation: FloatArray | Callable[[], FloatArray],
        slopes: Slopes,
        turns: Slopes,
        where: Where | None = None,
    ) -> None:
        super().__init__(position, slopes, where)
        self._rotation, self._turn = rotation, Variable(position, turns)

    @property
    def rotation(self) -> FloatArray:
        """The attitude of the frame (3, 3, S, K)."""
        if callable(self._rotation):  # computed when needed, because most goals are positions
            self._rotation = self._rotation()
        return self._rotation

    def axis(self, axis: Any) -> Variable:
        """Return a direction (3,) that is fixed in the frame, as a variable (3, S, K)."""
        a = apply(self.rotation, np.asarray(axis, dtype=np.float64)[:, None, None])
        return self._turned(a, lambda: -skew(a))  # a small rotation phi changes a by phi x a

    def rotation_vector_from(self, rotation: FloatArray) -> Variable:
        """Return the rotation vector (3, S, K) from an attitude to the frame's attitude [rad].

        The attitude `rotation` is (3, 3) or (3, 3, K), in the same axes as the frame's attitude.
        """
        r = self._from(rotation)

        def slope() -> FloatArray:
            # log(exp(phi) X) = r + J_l^-1(r) phi. J. Sola et al., "A micro Lie theory", 2018, eq. 146.
            angle = np.clip(np.sqrt(dot(r, r)), 1e-4, np.pi - 1e-3)
            factor = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
            R = skew(r)
            return np.asarray(EYE - 0.5 * R + factor * apply(R, R))

        return self._turned(r, slope)

    def angle_from(self, rotation: FloatArray) -> Variable:
        """Return the angle (S, K) between an attitude (3, 3) or (3, 3, K) and the frame's attitude [rad]."""
        r = self._from(rotation)
        angle = np.sqrt(dot(r, r) + 1e-18)  # finite slopes at zero
        # Only the component of a small rotation along r changes the angle.
        return Variable(angle, lambda: self._turn._along(r / angle), self.where)

    def during(self, span: slice) -> FrameVariable:
        """Return the frame of all motions at the instants in `span`."""
        place, turn = super().during(span), self._turn.during(span)
        slopes = (lambda: place.slopes, lambda: turn.slopes)
        return FrameVariable(place.value, lambda: self.rotation[..., span], *slopes, place.where)

    def moving_on(self, velocity: Variable, spin: Variable, by: FloatArray) -> FrameVariable:
        """Return the frame extrapolated by times (S, K) [s] at a constant velocity and angular velocity."""
        position, turn = self + by * velocity, exp3(by * spin.value)

        def turns() -> dict[str, FloatArray]:
            rotated = {name: apply(turn, slope) for name, slope in self._turn.slopes.items()}
            return rotated | {name: by * slope for name, slope in spin.slopes.items()}

        rotation = apply(turn, self.rotation)
        return FrameVariable(position.value, rotation, lambda: position.slopes, turns, self.where)

    def _from(self, rotation: FloatArray) -> FloatArray:
        return log3(np.einsum("xy...,zy...->xz...", self.rotation, rotation.reshape(3, 3, 1, -1)))

    def _turned(self, value: FloatArray, slope: Callable[[], FloatArray]) -> Variable:
        """Return a vector with its slopes (3, 3, S, K) with respect to a rotation of the frame."""

        def slopes() -> dict[str, FloatArray]:
            by = slope()
            return {name: by if turn is EYE else apply(by, turn) for name, turn in self._turn.slopes.items()}

        return Variable(value, slopes, self.where)


# The slope of each joint's quantity with respect to itself; `_OWN[0]` is the slope of a scalar.
_OWN = np.ones((1, 1, 1))
# The slope name of each velocity, and the slope name of the displacement that is its integral.
_VELOCITIES = {"by_velocity": "by_tip", "by_spin": "by_turn", "by_base_spin": "by_base_turn"}


def _moving(by: str, name: str, slope: FloatArray, doc: str) -> Any:
    """Return a property for a quantity of the motions as an independent variable."""
    return property(lambda m: m.variable(getattr(m.rollouts, name), {by: slope}), doc=doc)


class Variables:
    """The variables of S motions at K instants; other attributes are those of `Rollouts`.

    Variables are in inertial axes, except where base axes are stated. `rollouts` has the plain arrays.
    `duration` is the time from the start to the deadline [s]. `step` is the state of a single step, None for
    whole motions. `extra_margin` is the additional margin that a search requires in the residual of a limit,
    in the unit of the limit.
    """

    step: StepState | None = None

    def __init__(
        self,
        motions: Rollouts,
        duration: float | None = None,
        where: Where | None = None,
        extra_margin: float = 0.0,
    ) -> None:
        self.rollouts, self.where, self.extra_margin = motions, where, extra_margin
        self.duration = motions.duration if duration is None else duration

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "rollouts":
            raise AttributeError(name)
        return getattr(self.rollouts, name)

    def variable(self, value: FloatArray, slopes: Slopes) -> Variable:
        """Return a variable of these motions."""
        return Variable(value, slopes, self.where)

    @cached_property
    def tip(self) -> FrameVariable:
        """The position of the end effector (3, S, K) [m], a `FrameVariable`."""
        m = self.rollouts
        return FrameVariable(
            m.end_effector, lambda: m.attitude, {"by_tip": EYE}, {"by_turn": EYE}, self.where
        )

    @cached_property
    def base(self) -> FrameVariable:
        """The position of the base's centre of mass (3, S, K) [m], a `FrameVariable`."""
        m = self.rollouts
        return FrameVariable(
            m.base_position, m.base_attitude, {"by_base": EYE}, {"by_base_turn": EYE}, self.where
        )

    def frame(self, name: str, on: str = INERTIAL) -> FrameVariable:
        """Return the position of a frame of the robot, a `FrameVariable`; "tip" is the end effector.

        With `on="base"` position and attitude are relative to the base link's frame, in its axes.
        """
        m, frame = self.rollouts, RobotFrame.of(self.rollouts.stack, name)
        if frame.body is None and on == INERTIAL:
            return self.tip
        R, (position, rotation, linear, angular) = m.base_attitude, frame.of_arm(m.arm)
        if on == BASE:
            return FrameVariable(
                position, rotation, {"by_joints": linear}, {"by_joints": angular}, self.where
            )
        lever = apply(R, position - m.stack.base_com[:, None, None])
        return FrameVariable(
            m.base_position + lever,
            apply(R, rotation),
            lambda: {"by_base": EYE, "by_base_turn": -skew(lever), "by_joints": apply(R, linear)},
            lambda: {"by_base_turn": EYE, "by_joints": apply(R, angular)},
            self.where,
        )

    velocity = _moving("by_velocity", "velocity", EYE, "The velocity of the end effector (3, S, K) [m/s].")
    angular_velocity = _moving(
        "by_spin", "angular_velocity", EYE, "The angular velocity of the end effector (3, S, K) [rad/s]."
    )
    base_angular_velocity = _moving(
        "by_base_spin", "base_angular_velocity", EYE, "The angular velocity of the base (3, S, K) [rad/s]."
    )
    joints = _moving("own_joint", "joints", _OWN, "The joint positions (n, S, K) [rad, or m].")
    rates = _moving("own_rate", "rates", _OWN, "The joint rates (n, S, K) [rad/s, or m/s].")
    accelerations = _moving(
        "own_acceleration", "accelerations", _OWN, "The joint accelerations (n, S, K) [rad/s^2, or m/s^2]."
    )
    entropy = _moving("by_entropy", "entropy", _OWN[0], "The entropy H_norm (S, K).")

    @cached_property
    def to_goal(self) -> Variable:
        """The displacement to the goal from the end effector's position `delay` [s] earlier (3, S, K) [m]."""
        to_goal: Variable = self.goal - self.tip + self.rollouts.delay * self.velocity
        return to_goal

    @cached_property
    def distance(self) -> Variable:
        """The length of `to_goal` (S, K) [m], with finite slopes at zero."""
        return self.to_goal.norm(rounding=1e-5)

    @cached_property
    def speed(self) -> Variable:
        """The speed of the end effector (S, K) [m/s], with finite slopes at zero."""
        return Variable.norm(self.velocity, rounding=1e-6)

    @cached_property
    def cosine(self) -> Variable:
        """The paper's cos(theta_a) (S, K), between `to_goal` and the velocity of the end effector."""
        return self.to_goal.cosine(self.velocity, self.distance.value, self.speed.value)

    @cached_property
    def base_rotation_vector(self) -> Variable:
        """The rotation vector of the base from its attitude in `Problem.base_start` (3, S, K) [rad]."""
        return self.base.rotation_vector_from(self.rollouts.rotation_start)

    @cached_property
    def _forces(self) -> Variable:
        """The joint torques, and below them the base's constraint wrench (n + 6, S, K)."""
        m = self.rollouts

        def slopes() -> dict[str, FloatArray]:
            held = force_slopes(m.stack, m.joints, m.rates, m.accelerations, m.angular_drift)
            return _summed(held, momentum_force_slopes(m))

        return self.variable(m.forces, slopes)

    @property
    def torques(self) -> Variable:
        """The joint torques H_q qdd + C_q (n, S, K) with a reacting base [N m, or N]; qdd = 0 in a step.

        For a recording with torques they are the recorded torques.
        """
        torques: Variable = self._forces[:-6]
        return torques

    @property
    def wrench(self) -> Variable:
        """The wrench (6, S, K) that holds the base, about its centre of mass, base axes [N; N m]."""
        wrench: Variable = self._forces[-6:]
        return wrench

    @cached_property
    def arm_momentum(self) -> Variable:
        """The angular momentum of arm and base with the attitude held (3, S, K), base axes [N m s]."""
        m, D = self.rollouts, held_momentum(self.rollouts.arm)

        def slopes() -> dict[str, FloatArray]:
            by_joints = kernel.momentum_slopes(m.stack.tree, m.joints, m.rates)
            return {"by_joints": by_joints.reshape(3, *m.rates.shape), "by_rates": D}

        return self.variable(apply_rates(D, m.rates), slopes)

    @cached_property
    def wheels(self) -> Variable:
        """The momenta (w, S, K) of the wheels that hold the attitude [N m s]; w = 0 without such wheels."""
        momenta: Variable = self.wheel_total - wheel_shares(self.rollouts.wheels) @ self.arm_momentum
        measured = self.rollouts.measured_momenta
        return momenta if measured is None else self.variable(measured, lambda: momenta.slopes)

    @cached_property
    def wheel_torques(self) -> Variable:
        """The motor torques of the wheels (w, S, K) [N m], including the compensation of friction."""
        wheels = self.rollouts.wheels
        torques: Variable = -(wheel_shares(wheels) @ self.wrench[3:])
        if wheels is not None and wheels.rubs:
            speeds: Any = self.wheels / wheels.inertia
            torques = torques - wheels.friction_torque(speeds)
        return torques

    @property
    def time(self) -> Variable:
        """The time from the start (S, K) [s]."""
        value = np.broadcast_to(self.rollouts.times, self.rollouts.rates.shape[1:])
        return self.variable(value, {"by_time": _OWN[0]})

    @cached_property
    def goal(self) -> Variable:
        """The position of the goal (3, S, K) [m]; NaN in single steps."""
        m = self.rollouts
        value = np.zeros((3, *m.rates.shape[1:])) + m.target_points
        if m.target_on == INERTIAL:
            return Variable(value, None, self.where)
        return self.variable(value, lambda: {"by_base": EYE, "by_base_turn": -skew(value - m.base_position)})

    def weighted(self) -> Variables:
        """Return the variables at the instants with a quadrature weight above zero."""
        m = self.rollouts
        return self.at(*np.nonzero(np.broadcast_to(m.weights > 0.0, m.rates.shape[1:])))

    def at(self, motion: Indices | None, instants: Indices | slice) -> Variables:
        """Return V pairs of motion and instant, selected by indices (V,), as one motion with V instants.

        If `motion` is None, return these instants of all motions.
        """
        where = motion, np.arange(len(self.rollouts.times))[instants]
        return Variables(self.rollouts.at(motion, instants), self.duration, where, self.extra_margin)

    def with_margin(self, extra: float) -> Variables:
        """Return the variables with the additional margin `extra`."""
        same = extra == self.extra_margin
        return self if same else Variables(self.rollouts, self.duration, self.where, extra)

    def during(self, first: int, last: int) -> Variables:
        """Return the variables from instant `first` to instant `last`, both included."""
        span = slice(first, last + 1)
        selected = self.at(None, span)
        selected.tip = self.tip.during(span)
        return selected


class StepChange(NamedTuple):
    """The dependence of a variable with c components at a step's start on the joint rates u of the step."""

    value: FloatArray  # (c,) the value for the rates at the step's start
    flow: FloatArray  # (c, n) flow @ u + flow_drift is the rate of change due to the motion and to time
    flow_drift: FloatArray  # (c,)
    jump: FloatArray  # (c, n) the derivative with respect to u, with the configuration unchanged


class StepVariables(Variables):
    """The variables of a single step, as a motion of one instant, shape (..., 1, 1).

    Quantities of the step's state are reused; others are computed when they are needed.
    """

    step: StepState

    def __init__(self, step: StepState) -> None:
        self.step = step
        stack, R = step.sms.arm_stack(step.mode), pin.Quaternion(step.q[3:7]).toRotationMatrix()
        start = pin.XYZQUATToSE3(step.base_start)
        u, com = step.rates, step.sms.base_com
        # Velocities per joint rate, with the drift in the last column: the velocity of the base's centre of
        # mass, the base's angular velocity, and the twist of the end effector.
        root = np.column_stack([step.reaction, step.drift])
        base, base_spin = R @ (root[:3] - skew(com) @ root[3:]), R @ root[3:]
        tip = np.column_stack([step.J_star, step.tip_drift])
        self._moved = {
            "by_tip": tip[:3],
            "by_turn": tip[3:],
            "by_base": base,
            "by_base_turn": base_spin,
        }
        at = np.append(u, 1.0)
        motions = FixedRollouts(
            stack=stack,
            times=np.array([step.time]),
            weights=np.ones(1),
            limit_weights=np.ones(1),
            last_tenth=np.zeros(1, dtype=np.intp),
            joints=_single_instant(step.joints),
            rates=_single_instant(u),
            accelerations=_single_instant(np.zeros(len(u))),
            base_attitude=_single_instant(R),
            com=(step.q[:3] + R @ step.com)[:, None],
            drift=np.zeros(3) if step.momentum is None else step.momentum[:3] / stack.total_mass,
            angular_drift=_single_instant(step.drift[3:]),
            base_start=start.act(com),
            rotation_start=start.rotation,
            target=np.full((3, 1), np.nan),
            mean_speed=np.nan,
            wheels=step.wheels,
            wheel_total=np.zeros(len(step.wheels or ())) if step.wheel_total is None else step.wheel_total,
            time_offset=step.time_offset,
            end_effector=_single_instant(step.pose.translation),
            attitude=_single_instant(step.pose.rotation),
            velocity=_single_instant(tip[:3] @ at),
            angular_velocity=_single_instant(tip[3:] @ at),
            base_angular_velocity=_single_instant(base_spin @ at),
            base_position=_single_instant(step.q[:3] + R @ com),
        )
        super().__init__(motions, step.time + step.time_left)

    def change(self, variable: Variable) -> StepChange:
        """Return the dependence of a variable on the joint rates of the step."""
        m, n, c = self.rollouts, self.step.sms.n, variable.value.size
        flow, jump = np.zeros((c, n + 1)), np.zeros((c, n))
        for name, slope in variable.by_all().items() if c else ():
            if name == "by_entropy":
                name, slope = "by_coupling", slope[..., None, None, :, :] * m.entropy_and_slope[1]
            if name == "by_coupling":
                flow[:, :n] += coupling_slopes(m.stack, m.arm, slope).reshape(-1, n)
                continue
            slope = slope.reshape(c, -1)
            if name in self._moved:
                flow += slope @ self._moved[name]
            elif name in _VELOCITIES:
                jump += slope @ self._moved[_VELOCITIES[name]][:, :n]
            elif name == "by_time":
                flow[:, n] += slope[:, 0]
            elif name == "by_joints":
                flow[:, :n] += slope
            else:
                jump += slope / (self.step.dt if name == "by_accelerations" else 1.0)
        return StepChange(variable.value.reshape(c), flow[:, :n], flow[:, n], jump)


def _single_instant(x: Any) -> FloatArray:
    """Copy x with axes for one motion and one instant; x may be a read-only view."""
    return np.array(x, dtype=np.float64)[..., None, None]
