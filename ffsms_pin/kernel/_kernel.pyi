"""Types of the compiled kernel; arrays are dense and of float64."""

from collections.abc import Sequence
from typing import Any

from ffsms_pin.checks import FloatArray

def most_joints() -> int: ...

# step.hpp
def rate_bounds(
    limits: FloatArray, joints: FloatArray, rates: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]: ...
def wanted_motion(
    schedule: FloatArray,
    way: FloatArray,
    J: FloatArray,
    rates: FloatArray,
    drift: FloatArray,
    acceleration: FloatArray,
    side: FloatArray,
    cosine: float,
    time_left: float,
    dt: float,
) -> tuple[FloatArray, FloatArray, float, FloatArray] | None: ...
def scheduled(
    schedule: FloatArray,
    left: float,
    speed: float,
    gradient: FloatArray,
    acceleration: FloatArray,
    time_left: float,
    dt: float,
) -> float: ...
def reference_speed(
    schedule: FloatArray, path_left: float, speed: float, time_left: float, dt: float
) -> float: ...
def lateral_direction(towards: FloatArray, hint: FloatArray) -> FloatArray: ...
def objective(
    J: FloatArray,
    V: FloatArray,
    rates: FloatArray,
    drift: FloatArray,
    direction: FloatArray,
    speed: float,
    weights: FloatArray,
    plain_effort: bool,
) -> tuple[FloatArray, FloatArray]: ...
def stacked_rows(
    V: FloatArray, rows: Sequence[tuple[FloatArray, FloatArray, FloatArray, float]]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]: ...
def refined(
    H: FloatArray,
    g: FloatArray,
    A: FloatArray,
    low: FloatArray,
    up: FloatArray,
    z: FloatArray,
    tolerance: float,
    kept: float,
) -> tuple[FloatArray, FloatArray] | None: ...

# sums.hpp
def sums(
    spline: tuple[Any, ...],
    motions: tuple[Any, ...],
    residuals: Sequence[Any],
    joints: Sequence[Any],
    chosen: Any,
    gradient: FloatArray,
    hessian: FloatArray,
) -> None: ...
