"""Generate wrong and extreme values of arguments."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

__all__ = ["NUMBERS", "bad_value"]

# Values between 1e-6 and 1e9 are small integers only, because a duration of 1e5 s is valid, but takes long.
NUMBERS: tuple[Any, ...] = (
    0.0, -0.0, -1.0, 1.0, 5e-324, 1e-300, 1e-160, 1e-30, 1e-13, 1e10, 1e13, 1e30, 3e71, 1e154, 1e300,
    -1e300, -1e30, -1e-30, math.nan, math.inf, -math.inf,
)  # fmt: skip
WHOLE: tuple[Any, ...] = (0, 1, -1, 2, 2**31, 2**63, -(2**63), 10**30, 10**400, True, False)
TEXTS = ("", " ", "nan", "1e3", "none", "a\0b", "../..", "no such thing", "x" * 10_000, "\ud800", "planar_3r")
DTYPES = (np.float32, np.float64, np.int64, np.uint8, np.bool_, np.complex128, np.object_, np.str_)
SHAPES = ((), (0,), (1,), (2,), (3,), (4,), (6,), (9,), (10,), (3, 3), (6, 6), (1, 3), (2, 2, 2), (100_000,))


def bad_value(rng: random.Random, good: Any) -> Any:
    """Return a damaged copy of `good`, or a value of another type."""
    damaged: list[Callable[[], Any]] = []
    if isinstance(good, (int, float)) and not isinstance(good, bool):
        damaged = [lambda: rng.choice(NUMBERS), lambda: rng.choice(NUMBERS), lambda: rng.choice(WHOLE)]
    elif isinstance(good, (list, tuple)) and good and not isinstance(np.ravel(good)[0], np.number):
        damaged = [lambda: _other_parts(rng, tuple(good))] * 2
    elif isinstance(good, dict) and good:
        damaged = [lambda: {**good, rng.choice(list(good)): _thing(rng)}, lambda: {"no such thing": 1.0}]
    elif isinstance(good, (list, tuple, np.ndarray)):
        damaged = [lambda: _spoiled(rng, good), lambda: _spoiled(rng, good), lambda: _resized(rng, good)]
    elif isinstance(good, pin.SE3):
        damaged = [lambda: _pose(rng, good)] * 2
    elif isinstance(good, str):
        damaged = [lambda: rng.choice(TEXTS)] * 2
    chosen: Callable[[], Any] = rng.choice([*damaged, lambda: _thing(rng)])
    return chosen()


def _spoiled(rng: random.Random, good: Any) -> Any:
    """Return the array with one entry or all entries too large, too small or not finite."""
    array = np.array(good, dtype=np.float64)
    if array.size == 0 or rng.random() < 0.2:
        return np.full(array.shape, rng.choice(NUMBERS))
    array.flat[rng.randrange(array.size)] = rng.choice(NUMBERS)
    return array.tolist() if rng.random() < 0.3 else array


def _resized(rng: random.Random, good: Any) -> Any:
    """Return the numbers with another shape or type."""
    array = np.array(good, dtype=np.float64)
    choice = rng.randrange(5)
    if choice == 0:
        return array[..., :-1] if array.ndim else array
    if choice == 1:
        return np.concatenate([array.ravel(), [0.5]])
    if choice == 2:
        return array[np.newaxis]
    if choice == 3:
        return array.astype(rng.choice(DTYPES))
    return [array.tolist(), 1.0]  # ragged


def _other_parts(rng: random.Random, good: tuple[Any, ...]) -> Any:
    """Return some of the objects, one of them twice, or an additional wrong object."""
    choices = [(), good[1:], (*good, good[0]), (*good, _thing(rng)), good[0], iter(good), list(good)]
    return rng.choice(choices)


def _pose(rng: random.Random, good: Any) -> Any:
    """Return an invalid pose: a reflection, a scaled rotation, or an extreme position."""
    rotation, place = np.array(good.rotation), np.array(good.translation)
    choice = rng.randrange(4)
    if choice == 0:
        rotation = rotation @ np.diag([1.0, 1.0, -1.0])
    elif choice == 1:
        rotation = rotation * rng.choice(NUMBERS)
    elif choice == 2:
        place = place + rng.choice(NUMBERS)
    else:
        rotation = np.zeros((3, 3))
    return pin.SE3(rotation, place)


def _thing(rng: random.Random) -> Any:
    """Return an arbitrary object."""
    things: list[Callable[[], Any]] = [
        lambda: None,
        lambda: rng.choice(NUMBERS),
        lambda: rng.choice(WHOLE),
        lambda: rng.choice(TEXTS),
        lambda: np.full(rng.choice(SHAPES), rng.choice(NUMBERS)),
        lambda: np.zeros(rng.choice(SHAPES), dtype=rng.choice(DTYPES)),
        list,
        lambda: [[1.0], [1.0, 2.0]],
        dict,
        lambda: {"mass": 1.0},
        lambda: {1.0, 2.0},
        lambda: b"bytes",
        lambda: 1.0 + 2.0j,
        lambda: object(),
        lambda: int,
        lambda: lambda *_: None,
        lambda: range(3),
        lambda: iter([1.0, 2.0, 3.0]),
        lambda: np.datetime64("2025-01-01"),
        lambda: pin.SE3.Identity(),
        lambda: pin.Model(),
    ]
    return rng.choice(things)()
