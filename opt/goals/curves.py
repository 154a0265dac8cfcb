"""Curves of positions or poses, given by a function or by samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, length_text
from ffsms_pin.system.batch.stacks import dot, log3

POINT = "a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4, 4)"
_LEVER = 0.1  # [m] a rotation of one radian counts as this length of a curve
_TABLE = 1001  # number of parameters at which the length of a curve is tabulated


class Points(NamedTuple):
    """The K points of a curve: positions (3, K) [m], and rotations (3, 3, K) if the curve has attitudes."""

    positions: FloatArray
    rotations: FloatArray | None = None


class Curve(Protocol):
    """A curve, evaluated at parameters (K,) of any unit."""

    def __call__(self, parameters: FloatArray) -> Points:
        """Return the points of the curve at parameters (K,)."""


class FunctionCurve:
    """A curve given by a function of one number that returns a position (3,), a pose or a matrix (4, 4)."""

    def __init__(self, function: Callable[[float], Any], first: float) -> None:
        self._function = function
        begin = self._value(first)
        self._turned = isinstance(begin, pin.SE3)
        if self._turned:
            checks.rotation(f"curve({first:g})", begin.rotation)

    def _value(self, x: float) -> Any:
        name = f"curve({x:g})"
        value = checks.from_homogeneous(name, self._function(x))
        if isinstance(value, pin.SE3):
            return value
        try:
            position = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            position = np.zeros(0)
        if position.shape != (3,):
            raise InvalidValue(name, value, f"must be {POINT}")
        return position

    def __call__(self, parameters: FloatArray) -> Points:
        """Return the values of the function at parameters (K,)."""
        values = [self._value(x) for x in parameters.tolist()]
        if any(isinstance(value, pin.SE3) != self._turned for value in values):
            remedy = "must return positions only, or poses only"
            raise InvalidValue("curve", self._function, remedy)
        positions = np.array([x.translation if self._turned else x for x in values]).T
        rotations = np.array([x.rotation for x in values]).transpose(1, 2, 0) if self._turned else None
        finite = np.isfinite(positions).all(axis=0)
        if rotations is not None:
            finite &= np.isfinite(rotations).all(axis=(0, 1))
        if not finite.all():
            k = int(np.argmin(finite))
            name, position = f"curve({parameters[k]:g})", positions[:, k]
            if rotations is not None and np.isfinite(position).all():
                raise InvalidValue(f"{name}.rotation", rotations[:, :, k], "must be finite")
            raise InvalidValue(name, position, "must be finite [m]")
        return Points(positions, rotations)


class SampledCurve:
    """A curve through samples, interpolated by cubic splines with continuous accelerations.

    The `parameters` (K,) of the samples must increase. Before the first and after the last parameter the
    curve is constant.
    """

    def __init__(self, parameters: FloatArray, points: Points) -> None:
        from scipy.interpolate import CubicSpline  # slow to load

        self._ends = float(parameters[0]), float(parameters[-1])
        self._positions = CubicSpline(parameters, points.positions.T)
        self._rotations = None
        if points.rotations is not None:
            from scipy.spatial.transform import Rotation, RotationSpline

            turns = Rotation.from_matrix(points.rotations.transpose(2, 0, 1))
            self._rotations = RotationSpline(parameters, turns)

    def __call__(self, parameters: FloatArray) -> Points:
        """Return the points of the splines at parameters (K,)."""
        x = np.clip(parameters, *self._ends)
        rotations = None
        if self._rotations is not None:
            rotations = np.ascontiguousarray(self._rotations(x).as_matrix().transpose(1, 2, 0))
        return Points(np.ascontiguousarray(self._positions(x).T), rotations)


def sampled_points(samples: Any) -> Points:
    """Check the samples of a curve, and return them as points.

    The samples are positions (K, 3), K poses, or homogeneous matrices (K, 4, 4).
    """
    kinds = "positions (K, 3) [m], pinocchio.SE3s or homogeneous matrices (K, 4, 4)"
    if not isinstance(samples, Sequence | np.ndarray) or isinstance(samples, str):
        remedy = f"must be a function, or samples: {kinds}"
        raise InvalidValue("curve", samples, remedy)
    if len(samples) < 2:
        raise InvalidValue("curve", samples, f"must have at least two samples: {kinds}")
    if isinstance(samples[0], pin.SE3) or np.shape(samples[0]) == (4, 4):
        poses = [checks.pose(f"curve[{i}]", sample) for i, sample in enumerate(samples)]
        positions = np.array([pose.translation for pose in poses]).T
        return Points(positions, np.array([pose.rotation for pose in poses]).transpose(1, 2, 0))
    positions = checks.matrix("curve", samples, None, 3)
    return Points(np.ascontiguousarray(positions.T))


def sample_times(times: Any, count: int) -> FloatArray:
    """Check the times of `count` samples [s], and return them as an array.

    The times must begin at zero and increase.
    """
    t = checks.vector("times", times, count, "s")
    if t[0] != 0.0:
        remedy = "must begin at zero, because times are measured from the start of the path"
        raise InvalidValue("times", t[0], remedy)
    if (np.diff(t) <= 0.0).any():
        k = int(np.argmin(np.diff(t)))
        remedy = f"must increase, but times[{k + 1}] is no later than times[{k}] = {t[k]:g} s"
        raise InvalidValue("times", t[k + 1], remedy)
    return t


def lengths(points: Points) -> FloatArray:
    """Return the arc lengths (K,) [m] at K points of a curve; a rotation of 1 rad counts as 0.1 m."""
    steps = np.linalg.norm(np.diff(points.positions, axis=1), axis=0)
    if points.rotations is not None:
        R = points.rotations
        turns = log3(np.einsum("xyk,zyk->xzk", R[..., 1:], R[..., :-1]))
        steps = np.hypot(steps, _LEVER * np.sqrt(dot(turns, turns)))
    return np.concatenate([[0.0], np.cumsum(steps)])


class EvenCurve:
    """A geometric curve, parametrised by the share of its arc length from 0 to 1."""

    def __init__(self, curve: Curve, first: float, last: float) -> None:
        from scipy.interpolate import PchipInterpolator  # slow to load

        self._curve = curve
        parameters = np.linspace(first, last, _TABLE)
        along = lengths(curve(parameters))
        if along[-1] <= 0.0:
            point = curve(parameters[:1]).positions[:, 0]
            raise InvalidValue("curve", point, "must have a length, but all of its points coincide")
        moves = np.append(True, np.diff(along) > 1e-12 * along[-1])
        self._parameters = PchipInterpolator(along[moves] / along[-1], parameters[moves], extrapolate=False)
        self._last = along[moves][-1] / along[-1]

    def __call__(self, parameters: FloatArray) -> Points:
        """Return the points at shares (K,) of the length, clipped to [0, 1]."""
        return self._curve(self._parameters(np.clip(parameters, 0.0, self._last)))


_RAMP = 0.15  # share of the duration for acceleration to a constant speed, and for deceleration


def even_shares(x: FloatArray) -> FloatArray:
    """Return the covered shares (K,) of a curve's length at shares x (K,) of the duration.

    The speed is constant between a smooth start and a smooth end, which take 0.15 of the duration each.
    """

    def covered(y: FloatArray) -> FloatArray:  # the integral of 3 z^2 - 2 z^3 in the ramp, and of 1 after it
        z = np.clip(y / _RAMP, 0.0, 1.0)
        return _RAMP * (z**3 - 0.5 * z**4) + np.maximum(y - _RAMP, 0.0)

    x = np.clip(x, 0.0, 1.0)
    half = covered(np.minimum(x, 0.5))
    late = 1.0 - _RAMP - covered(np.minimum(1.0 - x, 0.5))
    return np.asarray(np.where(x <= 0.5, half, late) / (1.0 - _RAMP))


class TimeLaw(NamedTuple):
    """The time law of a curve: the covered share of its length, quadratic in time between K nodes."""

    times: FloatArray  # (K,) [s]
    shares: FloatArray  # (K,) of the curve's length
    rates: FloatArray  # (K,) [1/s]

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the shares at times t [s]; before zero and after the last node the share is constant."""
        t = np.clip(t, 0.0, self.times[-1])
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        h, span = t - self.times[k], self.times[k + 1] - self.times[k]
        return np.asarray(
            self.shares[k] + h * (self.rates[k] + 0.5 * h / span * (self.rates[k + 1] - self.rates[k]))
        )

    def slower(self, scale: float) -> TimeLaw:
        """Return the law with times multiplied by `scale`."""
        return TimeLaw(scale * self.times, self.shares, self.rates / scale)


def check_jumps(curve: Curve, parameters: FloatArray, unit: str) -> None:
    """Raise `InvalidValue` if a curve jumps between parameters (K,).

    A jump is a change of the curve that does not shrink with the interval of parameters. The message contains
    the parameters' `unit`.
    """
    points = curve(parameters)
    steps = np.diff(lengths(points))
    k = int(np.argmax(steps))
    if steps[k] <= 20.0 * float(np.median(steps)) + 1e-6:
        return
    low, high = float(parameters[k]), float(parameters[k + 1])
    for _ in range(30):
        middle = 0.5 * (low + high)
        first, second = np.diff(lengths(curve(np.array([low, middle, high]))))
        low, high = (low, middle) if first >= second else (middle, high)
    sides = curve(np.array([low, high]))  # the points before and after the jump
    jump = float(lengths(sides)[-1])
    if jump > 0.5 * steps[k]:
        size = length_text(jump)
        if points.rotations is not None:
            size += f" (1 rad counts as {length_text(_LEVER)})"
        remedy = (
            f"must be continuous, but it jumps near {low:.6g} {unit} by {size}; "
            "plan its parts as separate motions"
        )
        raise InvalidValue("curve", np.round(sides.positions.T, 6).tolist(), remedy)
