"""The types of the compiled kernel: `Array` is contiguous and of float64, index arrays (Any) are of int64."""

from collections.abc import Sequence
from typing import Any, TypeAlias

from ffsms_pin.checks import FloatArray as Array

Pair: TypeAlias = tuple[Array, Array]
Quadrature: TypeAlias = tuple[Array, Array, int]  # integral_to_points, integral_over, late

class Tree:
    """A tree of at most 64 joints, each parent before its children.

    A row of `joints` (n, 17) has the parent's index (-1: the base), 1 for a revolute or 0 for a prismatic
    joint, the axis (3), and the attitude (9) and position (3) of the joint frame in its parent. A row of
    `bodies` (n + 1, 13), the base first, has mass, centre of mass (3), and inertia about the centre of mass
    (9). `tip` (12,) has the attitude and position of the end effector in the frame of joint `last`.
    `translates` and `rotates` are True if the base can translate and rotate.
    """

    n: int
    def __init__(
        self, joints: Array, bodies: Array, tip: Array, last: int, translates: bool, rotates: bool, /
    ) -> None: ...

# module.cpp: from arrays (rows, ...) to new arrays (rows, B)
def arm_values(tree: Tree, positions: Array, /) -> Array: ...
def coupled(tree: Tree, positions: Array, /) -> Array: ...
def reduced_inertia(tree: Tree, positions: Array, /) -> Array: ...
def velocity_slopes(tree: Tree, positions: Array, rates: Array, own: Array | None = None, /) -> Array: ...
def momentum_slopes(tree: Tree, positions: Array, rates: Array, /) -> Array: ...
def coupling_slopes(tree: Tree, positions: Array, by_coupling: Array, /) -> Array: ...
def dynamics(tree: Tree, joints: Array, rates: Array, accelerations: Array, own_spin: Array, /) -> Array: ...
def rotation_vectors(rotations: Array, /) -> Array: ...
def entropies(coupling: Array, /) -> Array: ...
def singular_values(matrices: Array, vectors: bool, /) -> Array: ...

# bind_motions.cpp
def attitudes(start: Array, omega: Array, dt: float, /) -> Array: ...
def roll_out(tree: Tree, start: Array, accelerations: Array, momentum: Array, dt: float, /) -> Array: ...
def spline_attitudes(
    quadrature: Quadrature, omega: Array, inverse: Array, start: Array, momentum: Array, /
) -> Array: ...
def sums(
    tree: Tree,
    maps: Array,
    quadrature: Quadrature,
    motions: Array,
    residuals: Sequence[Any],
    chosen: Any,
    gradient: Array,
    hessian: Array,
    momentum: Array | None = None,
    /,
) -> None: ...
def cholesky(matrix: Array, /) -> Array | None: ...
def solve_lower(factor: Array, right: Array, /) -> Array: ...
def solve_upper(factor: Array, right: Array, /) -> Array: ...

# bind_step.cpp
ARRIVAL_POWER: float

def step_state(
    tree: Tree, root: Array, joints: Array, momentum: Array | None, /
) -> tuple[Array, Array, Array]: ...
def rate_bounds(limits: Array, joints: Array, rates: Array, dt: float, /) -> Array: ...
def reference_speed(path_left: float, speed: float, time_left: float, dt: float, /) -> float: ...
def ideal_cosine(entropy: float, kappa: float, /) -> float: ...
def step_qp(
    to_target: Array,
    rotation: Array | None,
    attitude: Array,
    J: Array,
    V: Array,
    rates: Array,
    drift: Array,
    acceleration: Array,
    side: Array,
    cosine: float,
    time_left: float,
    dt: float,
    weights: Array,
    limits: Sequence[tuple[Array, Array, Array, float]],
    /,
) -> tuple[Array, Array, tuple[Array, Array, Array]]: ...
def refined(
    H: Array, g: Array, A: Array, low: Array, up: Array, z: Array, tolerance: float, /
) -> Pair | None: ...

# bind_clearance.cpp: `table` is `PartPairs._table`
def near_points(tree: Tree, joints: Array, columns: Any, at: Any, ends: Any, box: Array, /) -> Pair: ...
def distance_slopes(
    tree: Tree, joints: Array, bodies: Any, columns: Any, at: Any, points: Array, /
) -> Pair: ...
def near_parts(
    tree: Tree,
    joints: Array,
    turns: Array,
    origins: Array,
    columns: Any,
    at: Any,
    near: Array,
    /,
    *table: Any,
) -> tuple[Array, Array, list[tuple[int, list[tuple[float, int]], Array]]]: ...
