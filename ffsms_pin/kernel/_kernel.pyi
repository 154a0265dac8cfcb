"""Types of the compiled kernel; arrays are dense and of float64."""

from collections.abc import Sequence
from typing import Any

from ffsms_pin.checks import FloatArray

class Tree:
    """The robot in plain numbers: at most 64 joints, parents first.

    `joints` (n, 18): parent, turns, moves_tip, axis (3), offset (3), placement (9). `bodies` (n + 1, 13), the
    base first: mass, lever (3), inertia about the centre of mass (9). `tip` (1, 12): place, attitude.
    """

    n: int
    def __init__(
        self, joints: FloatArray, bodies: FloatArray, tip: FloatArray, last: int, moves: bool, free: bool, /
    ) -> None: ...

# bind_stacks.cpp: of (rows, ...), rows (.., B)
def arm_values(tree: Tree, positions: FloatArray, /) -> FloatArray: ...
def poses(tree: Tree, positions: FloatArray, /) -> FloatArray: ...
def coupled(tree: Tree, positions: FloatArray, /) -> FloatArray: ...
def manipulator_jacobian(tree: Tree, positions: FloatArray, /) -> FloatArray: ...
def reduced_inertia(tree: Tree, positions: FloatArray, /) -> FloatArray: ...
def velocity_slopes(tree: Tree, positions: FloatArray, rates: FloatArray, /) -> FloatArray: ...
def momentum_slopes(tree: Tree, positions: FloatArray, rates: FloatArray, /) -> FloatArray: ...
def coupling_slopes(tree: Tree, positions: FloatArray, by_coupling: FloatArray, /) -> FloatArray: ...
def dynamics(
    tree: Tree, joints: FloatArray, rates: FloatArray, accelerations: FloatArray, own_spin: FloatArray, /
) -> FloatArray: ...
def entropies(coupling: FloatArray, /) -> FloatArray: ...
def singular_values(matrices: FloatArray, vectors: bool, /) -> FloatArray: ...

# bind_motions.cpp
def attitudes(start: FloatArray, omega: FloatArray, dt: float, /) -> FloatArray: ...
def roll_out(
    tree: Tree, start: FloatArray, accelerations: FloatArray, momentum: FloatArray, dt: float, /
) -> FloatArray: ...
def spline_attitudes(
    quadrature: tuple[FloatArray, FloatArray, int],
    omega: FloatArray,
    inverse: FloatArray,
    start: FloatArray,
    momentum: FloatArray | None,
    /,
) -> FloatArray: ...
def sums(
    tree: Tree,
    maps: tuple[FloatArray, FloatArray, FloatArray],
    quadrature: tuple[FloatArray, FloatArray, int],
    motions: tuple[Any, ...],
    residuals: Sequence[Any],
    of_joints: Sequence[Any],
    chosen: Any,
    /,
) -> tuple[FloatArray, FloatArray]: ...
def cone_marches(
    tree: Tree,
    steps: int,
    duration: float,
    kappa: float,
    mean_speed: float,
    arrival_power: float,
    least_approach: float,
    damping: float,
    joints: FloatArray,
    places: FloatArray,
    attitude: FloatArray,
    rotation: FloatArray | None,
    sides: FloatArray,
) -> FloatArray: ...

# step.hpp
def step_state(
    tree: Tree, root: FloatArray, joints: FloatArray, momentum: FloatArray | None
) -> tuple[FloatArray, FloatArray]: ...
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

# points.hpp, clearance.hpp
def near_points(
    tree: Tree, joints: FloatArray, columns: Any, at: Any, ends: Any, box: FloatArray
) -> tuple[FloatArray, FloatArray]: ...
def distance_slopes(
    tree: Tree, joints: FloatArray, bodies: Any, columns: Any, at: Any, points: FloatArray
) -> tuple[FloatArray, FloatArray]: ...
def near_parts(
    tree: Tree,
    joints: FloatArray,
    turns: FloatArray,
    origins: FloatArray,
    columns: Any,
    at: Any,
    near: FloatArray,
    bodies: FloatArray,
    parts: FloatArray,
    ends: Any,
    starts: Any,
    pairs: Any,
    corners: FloatArray,
    begins: Any,
    rounds: FloatArray,
) -> tuple[FloatArray, list[tuple[int, float, list[tuple[float, int]]]], FloatArray]: ...
