"""Checks of arguments, which return a checked value or raise `InvalidValue` with the wrong value.

Numbers are checked once, in the functions that users call, for a plausible range. By default magnitudes are
limited to 1e9, where float64 still resolves a tenth of a micrometre. A single number that must be positive,
such as a mass, may lie between 1e-12 and 1e12, so that products and quotients of a dozen such numbers stay
finite. An inertia may be up to 1e18 kg m^2, enough for an asteroid. Infinity is allowed only for limits that
document it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.errors import InvalidValue

FloatArray: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.signedinteger[Any]]

LARGEST = 1e9
SMALLEST_POSITIVE, LARGEST_POSITIVE = 1e-12, 1e12
# [m] Largest length within a robot or a client. Tethers of 30 km have flown; an asteroid of 1e12 kg is 1 km
# wide.
LONGEST = 1e5
_LARGEST_INERTIA = 1e18  # [kg m^2]; the inertia of an asteroid of 1e12 kg is 1e17
_SMALLEST_RADIUS = 1e-6  # [m] smallest radius of gyration
# Largest distance of a centre of mass from the frame's origin, in radii of gyration. At this distance an
# inertia about the origin determines the inertia about the centre of mass to six digits only.
_MOST_RADII = 1e5
_FLOAT64 = np.dtype(np.float64)
# Errors of NumPy for values that are not arrays, such as rows of different lengths.
_NO_ARRAY = (TypeError, ValueError, OverflowError, RuntimeError)
MOST_STEPS = 10_000_000  # largest number of steps of a run, which take over 5 GB of memory for seven joints


def _floats(name: str, value: Any) -> FloatArray:
    array = np.array(reals(name, value))
    if not np.isfinite(array).all():
        raise InvalidValue(name, value, "must be finite")
    return array


def reals(name: str, value: Any, kinds: str = "fiu") -> FloatArray:
    """Return `value` as an array of real numbers of any shape; NaN and infinity are accepted."""
    try:
        array = np.asarray(value)
    except _NO_ARRAY:
        array = np.empty(0, dtype=object)
    # A direct conversion to float would parse text as numbers and drop imaginary parts.
    if array.dtype.kind not in kinds:
        raise InvalidValue(name, value, "must contain real numbers only")
    return np.asarray(array, dtype=np.float64)


def _within(name: str, value: Any, array: FloatArray, largest: float = LARGEST) -> FloatArray:
    """Check that no number of an array is larger than `largest` in magnitude, and return the array."""
    # For short arrays Python's max is several times faster than NumPy's.
    if largest < math.inf and max(map(abs, array.ravel().tolist()), default=0.0) > largest:
        raise InvalidValue(name, value, f"must lie between {-largest:g} and {largest:g}")
    return array


def vector(name: str, value: ArrayLike, size: int, unit: str = "", largest: float = LARGEST) -> FloatArray:
    """Copy `value` as a finite vector of `size` numbers with magnitudes up to `largest`."""
    if isinstance(value, np.ndarray) and value.dtype == _FLOAT64 and value.shape == (size,):
        # The most common case. A norm below `largest` excludes infinite and NaN entries.
        length = math.hypot(*value.tolist())
        if length < largest:
            return np.array(value)
    array = _floats(name, value)
    if array.shape != (size,):
        expected = f"must have shape ({size},){unit and f' [{unit}]'}"
        raise InvalidValue(name, value, f"{expected} but has shape {array.shape}")
    return _within(name, value, array, largest)


def direction(name: str, value: ArrayLike) -> FloatArray:
    """Return the unit vector (3,) along `value`, read-only."""
    along = vector(name, value, 3)
    if (length := math.hypot(*along.tolist())) < 1e-9:
        raise InvalidValue(name, value, "must not be zero")
    return frozen(along / length)


def matrix(
    name: str, value: ArrayLike, rows: int | None, columns: int | None, largest: float = LARGEST
) -> FloatArray:
    """Copy `value` as a finite matrix (rows, columns) with magnitudes up to `largest`.

    A dimension that is None may have any size.
    """
    array = _floats(name, value)
    if array.ndim != 2 or len(array) != (rows or len(array)) or array.shape[1] != (columns or array.shape[1]):
        expected = f"must have shape ({rows or 'k'}, {columns or 'n'})"
        raise InvalidValue(name, value, f"{expected} but has shape {array.shape}")
    return _within(name, value, array, largest)


def inertia(name: str, value: Any) -> FloatArray:
    """Return a rigid body's inertia (3, 3) [kg m^2], from a matrix or three principal inertias."""
    if dimensions(name, value) == 1:
        tensor = np.diag(vector(name, value, 3, "kg m^2", _LARGEST_INERTIA))
    else:
        tensor = matrix(name, value, 3, 3, _LARGEST_INERTIA)
    if np.abs(tensor - tensor.T).max() > 1e-9 * np.abs(tensor).max():
        raise InvalidValue(name, value, "must be symmetric")
    a, b, c = np.linalg.eigvalsh(tensor)
    if a < SMALLEST_POSITIVE:
        message = f"must be positive definite, {SMALLEST_POSITIVE:g} kg m^2 or more about every axis"
        raise InvalidValue(name, value, message)
    if a + b < c * (1.0 - 1e-9):
        message = "violates the triangle inequality: no principal inertia may exceed the sum of the other two"
        raise InvalidValue(name, value, message)
    return tensor


def gyration_radius(mass: float, inertia: FloatArray) -> float:
    """Return the root mean square distance [m] of a body's mass from its centre of mass."""
    return math.sqrt(abs(float(np.trace(inertia))) / (2.0 * mass))


def inertia_problem(mass: float, inertia: FloatArray) -> str:
    """Return an error text if no body of this mass [kg] can have this inertia (3, 3) [kg m^2], else ""."""
    radius = gyration_radius(mass, inertia)
    if _SMALLEST_RADIUS <= radius <= LONGEST:
        return ""
    between = f"it must lie between {_SMALLEST_RADIUS:g} and {LONGEST:g} m"
    return f"has a radius of gyration of {radius:.3g} m with {mass:g} kg; {between}: check units and mass"


def com_problem(mass: float, inertia: FloatArray, com: FloatArray) -> str:
    """Return an error text if a body's centre of mass cannot be at `com` (3,) [m], else ""."""
    radius, distance = gyration_radius(mass, inertia), math.hypot(*com.tolist())
    most = min(LONGEST, _MOST_RADII * radius)
    if distance <= most:
        return ""
    far = f"lies {distance:.3g} m from the frame's origin, far outside a body whose radius of gyration is"
    return f"{far} {radius:.3g} m; it must lie within {most:.3g} m: check the units of both"


def rigid_body(name: str, mass: Any, tensor: Any, com: Any) -> tuple[float, FloatArray, FloatArray]:
    """Check a body and return its mass [kg], inertia (3, 3) [kg m^2] and centre of mass (3,) [m]."""
    mass, com = positive(f"{name}.mass", mass, "kg"), vector(f"{name}.com", com, 3, "m")
    checked = inertia(f"{name}.inertia", tensor)
    if problem := inertia_problem(mass, checked):
        raise InvalidValue(f"{name}.inertia", tensor, problem)
    if problem := com_problem(mass, checked, com):
        raise InvalidValue(f"{name}.com", com, problem)
    return mass, checked, com


def number(name: str, value: Any) -> float:
    """Return a finite number of magnitude up to 1e9."""
    if type(value) is float and -LARGEST <= value <= LARGEST:  # the most common case, in every control step
        return value
    return float(_within(name, value, _scalar(name, value)))


def positive(name: str, value: Any, unit: str = "") -> float:
    """Return a finite number above zero, between 1e-12 and 1e12."""
    if type(value) is float and SMALLEST_POSITIVE <= value <= LARGEST_POSITIVE:  # as in `number`
        return value
    result = float(_scalar(name, value))
    of = unit and f" [{unit}]"
    if result <= 0.0:
        raise InvalidValue(name, value, f"must be above zero{of}")
    if not SMALLEST_POSITIVE <= result <= LARGEST_POSITIVE:
        message = f"must lie between {SMALLEST_POSITIVE:g} and {LARGEST_POSITIVE:g}{of}"
        raise InvalidValue(name, value, message)
    return result


def positives(
    name: str, value: ArrayLike, size: int, unit: str = "", largest: float = LARGEST
) -> tuple[float, ...]:
    """Return `size` finite numbers above zero as a tuple; unlike arrays, tuples can be compared by ==."""
    numbers = tuple(vector(name, value, size, unit, largest).tolist())
    if min(numbers) <= 0.0:
        raise InvalidValue(name, value, f"must be above zero{unit and f' [{unit}]'}")
    return numbers


def limit(name: str, value: Any, unit: str = "") -> float:
    """Return a limit, which is a number above zero or infinity for no limit."""
    return math.inf if isinstance(value, float) and value == math.inf else positive(name, value, unit)


def _scalar(name: str, value: Any) -> FloatArray:
    if isinstance(value, (bool, np.bool_)):
        raise InvalidValue(name, value, "must be a number")
    array = _floats(name, value)
    if array.shape != ():
        raise InvalidValue(name, value, "must be one number")
    return array


def step_count(name: str, duration: float, dt: float, most: int = MOST_STEPS) -> int:
    """Return the number of steps of dt in a duration [s], between one and `most`."""
    if duration / dt > most:
        message = f"divides {duration:g} s into {duration / dt:.3g} steps; at most {most:g} are allowed, so"
        message += " use a longer step"
        raise InvalidValue(name, dt, message)
    return max(1, round(duration / dt))


_IN_WORDS: Mapping[type, str] = {
    Sequence: "a sequence",
    Mapping: "a mapping",
    Iterable: "an iterable",
    str: "a text",
}


def instance(name: str, value: Any, kind: type | tuple[type, ...], optional: bool = False) -> None:
    """Raise `InvalidValue` unless `value` is an instance of `kind`, or None with `optional`."""
    single = isinstance(value, np.ndarray) and not value.ndim  # a 0-d array is an instance of Iterable
    if single or not (isinstance(value, kind) or (optional and value is None)):
        kinds = kind if isinstance(kind, tuple) else (kind,)
        expected = " or ".join([_in_words(kind) for kind in kinds] + ["None"] * optional)
        raise InvalidValue(name, value, f"must be {expected}")


def _in_words(kind: type) -> str:
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    return _IN_WORDS.get(kind, f"{article} {kind.__name__}")


def names(name: str, value: Any, known: Collection[str], of: str) -> tuple[str, ...]:
    """Check a sequence of names and return it as a tuple.

    `of` is the kind of the names in messages, such as "joints". A bare string is refused, because it would be
    iterated character by character.

    Raises
    ------
    InvalidValue
        The value is not a sequence, or an entry is not in `known`.
    """
    listed = ", ".join(known)
    if isinstance(value, str) or not isinstance(value, Sequence):
        example = f"; a single one is {name}=['{value}']" if value in known else ""
        raise InvalidValue(name, value, f"must be a sequence of names of {of} ({listed}){example}")
    for i, item in enumerate(value):
        if item not in known:
            raise InvalidValue(f"{name}[{i}]", item, f"must be one of the {of} ({listed})")
    return tuple(value)


def optional_callable(name: str, value: Any) -> None:
    """Raise `InvalidValue` unless `value` is callable or None."""
    if value is not None and not callable(value):
        raise InvalidValue(name, value, "must be a function or None")


def one_of(name: str, value: Any, choices: Collection[str]) -> str:
    """Return `value` if it is one of `choices`, else raise `InvalidValue`."""
    if not isinstance(value, str) or value not in choices:
        raise InvalidValue(name, value, "must be " + " or ".join(f'"{choice}"' for choice in choices))
    return value


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return a whole number between `least` and `most`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InvalidValue(name, value, f"must be a whole number of at least {least}")
    if most is not None and value > most:
        raise InvalidValue(name, value, f"must not exceed {most}")
    return int(value)


def dimensions(name: str, value: Any) -> int:
    """Return the number of dimensions of `value` as an array: 0, 1 or 2."""
    try:
        count = np.ndim(value)
    except _NO_ARRAY:
        count = 3
    if count > 2:
        raise InvalidValue(name, value, "must be a number, a vector or a matrix")
    return count


def common_length(rows: Mapping[str, Sequence[Any]]) -> int:
    """Return the common length of named sequences; 1 without sequences."""
    lengths = [len(row) for row in rows.values()] or [1]
    if len(set(lengths)) > 1:
        lengths_by_name = ", ".join(f"{len(row)} of {name}" for name, row in rows.items())
        raise InvalidValue("the sequences", lengths_by_name, "must have equal lengths")
    return lengths[0]


def per_joint(name: str, value: Any, n: int, unit: str = "") -> FloatArray:
    """Return n numbers (n,), from a single number for all joints or from n numbers."""
    if dimensions(name, value) == 0:
        return np.full(n, number(name, value))
    return vector(name, value, n, unit)


def one_each(
    name: str,
    value: Any,
    count: int,
    unit: str = "",
    *,
    least: float = SMALLEST_POSITIVE,
    largest: float = LARGEST,
) -> FloatArray:
    """Return read-only numbers (count,) between `least` and `largest`, from one number or `count` numbers.

    Infinity is accepted if `largest` is infinite.
    """
    dimensions(name, value)
    array, of = np.asarray(value), unit and f" [{unit}]"
    if array.dtype.kind not in "fiu" or array.shape not in ((), (count,)):
        raise InvalidValue(name, value, f"must be one number, or have shape ({count},){of}")
    numbers = np.full(count, array, dtype=np.float64)
    if not ((numbers >= least) & (numbers <= largest)).all():  # also refuses NaN
        small = bool(((numbers > 0.0) & (numbers < least)).any())
        bound = f"at least {least:g}" if small else "above zero" if least else "at least zero"
        message = f"must be {bound}{of}"
        raise InvalidValue(
            name, value, message if largest == math.inf else f"{message}, and at most {largest:g}"
        )
    return frozen(numbers)


def rotation(name: str, value: Any) -> FloatArray:
    """Check a rotation matrix (3, 3) and return a copy; a reflection or a scaled matrix is rejected."""
    turn = matrix(name, value, 3, 3)
    if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-6 or np.linalg.det(turn) < 0.0:
        raise InvalidValue(name, value, "must have a rotation matrix, without scaling or reflection")
    return turn


def pose(name: str, value: Any) -> Any:
    """Check a pose and return a new pinocchio.SE3, from a pinocchio.SE3 or a homogeneous matrix (4, 4)."""
    placed = from_homogeneous(name, value)
    if not isinstance(placed, pin.SE3):
        raise InvalidValue(name, value, "must be a pinocchio.SE3, or a homogeneous matrix (4, 4)")
    return pin.SE3(rotation(name, placed.rotation), vector(name, placed.translation, 3, "m"))


def from_homogeneous(name: str, value: Any) -> Any:
    """Convert a homogeneous matrix (4, 4) to a pinocchio.SE3; return any other value unchanged."""
    if isinstance(value, pin.SE3) or not isinstance(value, (np.ndarray, Sequence)) or len(value) != 4:
        return value
    try:
        if np.shape(value) != (4, 4):
            return value
    except _NO_ARRAY:
        return value
    T = _floats(name, value)
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        message = "must be a homogeneous matrix, so its last row must be [0, 0, 0, 1]"
        raise InvalidValue(name, value, message)
    return pin.SE3(rotation(name, T[:3, :3]), T[:3, 3])


def at_least_zero(name: str, value: Any, unit: str = "") -> float:
    """Return a finite number that is at least zero."""
    if (result := number(name, value)) < 0.0:
        raise InvalidValue(name, value, f"must be at least zero{unit and f' [{unit}]'}")
    return result


def share(name: str, value: Any) -> float:
    """Return a number in [0, 1)."""
    if (result := at_least_zero(name, value)) >= 1.0:
        raise InvalidValue(name, value, "must be below one")
    return result


def frozen(array: FloatArray) -> FloatArray:
    """Make an array read-only and return it."""
    array.setflags(write=False)
    return array


def set_frozen(made: object, **values: Any) -> None:
    """Set attributes of a frozen object during its construction."""
    for name, value in values.items():
        object.__setattr__(made, name, value)
