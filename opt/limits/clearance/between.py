"""What bodies keep apart of a finished motion: at its instants, and proven between them.

Between two instants a distance changes by no more than the joints' way times their reach, and by what the
obstacle moves and turns as the base sees it. Where that leaves a clearance in question, the interval is
halved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.poses import Poses
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices

__all__ = ["Least", "along", "least_between", "least_of"]

# How often an interval between two instants is halved, and how many clearances are measured in between at
# most.
_HALVINGS, _MOST = 12, 5000
_STRIDE = 16  # of the instants that are measured first
# The chord of an obstacle's way from one instant to the next, over which it turns by a few hundredths of a
# radian, is shorter than the way itself by less than this share.
_CHORD = 0.02


class Least(NamedTuple):
    """The least clearance of a motion.

    Attributes
    ----------
    value : float
        [m]; a bound from below where it lies between instants and could not be proven kept.
    pair : int
        Which clearance.
    time : float
        [s]
    near : ndarray, shape (k,)
        Instants at which a clearance is nearly used up [s].
    """

    value: float
    pair: int
    time: float
    near: FloatArray


def least_of(stack: ClearanceStack, motion: Motions, clearance: float, binding: float) -> Least:
    """The least clearance of one motion at its nodes, in the middles, and between them.

    What convex parts find broken is measured on the shapes.
    """
    times, poses = motion.times, stack.seen(motion)
    if stack.reaches is None:  # not bounded
        values = stack.values(poses)
        which, k = np.unravel_index(int(np.argmin(values)), values.shape)
        close = times[values.min(axis=0) < clearance + binding]
        return Least(float(values[which, k]), int(which), float(times[k]), close)
    change = changes(stack, motion, poses)
    near, floor = clearance + binding + 0.5 * float(change.max(initial=0.0)), clearance - stack.tolerance
    values = along(change, near, lambda pair, k, near: stack.nearest(poses, (pair, k), near).distance)
    low = np.nonzero(values < floor)
    if low[0].size:
        values[low] = stack.exact(poses, low, floor)
    which, k = np.unravel_index(int(np.argmin(values)), values.shape)
    close = times[values.min(axis=0) < clearance + binding]
    least = Least(float(values[which, k]), int(which), float(times[k]), close)
    if least.value < floor:
        return least
    # How far a base that turns evenly between two instants is from where it is: the error of the angle is at
    # most the change of the angular velocity times the time over 8.
    turn = np.linalg.norm(np.diff(motion.base_spin[:, 0]), axis=0) * np.diff(times) / 8.0
    bend = (stack.passes * (stack.arm.length + stack.sizes[:, 0]))[:, None] * turn

    def measure(pair: Indices, k: Indices, after: FloatArray) -> FloatArray:
        here, lost = stack.between(motion, k, after), bend[pair, k]
        found = stack.exact(here, (pair, np.arange(len(pair))), floor + float(lost.max(initial=0.0)))
        return np.asarray(found - lost)

    between = least_between(times, values, change, floor, measure)
    return least if between is None else between._replace(near=close)


def changes(stack: ClearanceStack, motion: Motions, poses: Poses) -> FloatArray:
    """The most that distances change from one instant of a motion to the next (m, K - 1) [m]."""
    u = motion.rates[:, 0]
    # Rates are linear in between, so no joint goes further than this.
    change = stack.reaches @ (np.diff(motion.times) * np.maximum(np.abs(u[:, :-1]), np.abs(u[:, 1:])))
    if stack.passes.any():
        index = stack.bodies[stack.passes, 1]
        far = stack.sizes[stack.passes, 1:]
        # Places and, as chords of points at a unit distance, turns.
        ways = [np.diff(poses.origins[:, index]), np.diff(poses.rotations[:, :, index]) / np.sqrt(2.0)]
        bends = [np.diff(one) for one in ways]
        way, bend = (
            np.linalg.norm(a, axis=0) + far * np.linalg.norm(b, axis=(0, 1)) for a, b in (ways, bends)
        )
        # The largest speed exceeds the mean one by half of what a velocity changes in between.
        bend = np.pad(bend, ((0, 0), (1, 1)))
        change[stack.passes] += (1.0 + _CHORD) * way + 0.5 * np.maximum(bend[:, 1:], bend[:, :-1])
    return np.asarray(change)


def along(
    change: FloatArray, near: float, measure: Callable[[Indices, Indices, FloatArray], FloatArray]
) -> FloatArray:
    """Distances (m, K) at the instants of a motion: exact below `near`, else bounds from below.

    Some instants come first. Those in between are measured where these leave them in question.

    Parameters
    ----------
    change : ndarray, shape (m, K - 1)
        The most that a distance can change from one instant to the next [m].
    near : float
        [m]
    measure : callable
        Distances (V,) of pairs (V,) at instants (V,): exact below so much (V,), else bounds from below.
    """
    pairs, count = len(change), change.shape[1] + 1
    way = np.concatenate([np.zeros((pairs, 1)), np.cumsum(change, axis=1)], axis=1)
    first = np.append(np.arange(0, count - 1, _STRIDE), count - 1)
    # What is farther than this at both ends of an interval is farther than `near` inside it.
    enough = near + 0.5 * np.diff(way[:, first]).max(axis=1, initial=0.0)
    every = np.repeat(np.arange(pairs), len(first)), np.tile(first, pairs)
    found = measure(*every, np.repeat(enough, len(first))).reshape(pairs, -1)
    after = np.searchsorted(first, np.arange(count))
    before = np.maximum(after - 1, 0)
    values: FloatArray = np.maximum(
        found[:, before] - (way - way[:, first[before]]), found[:, after] - (way[:, first[after]] - way)
    )
    values[:, first] = found
    asked = values < near
    asked[:, first] = False
    k, pair = np.nonzero(asked.T)
    values[pair, k] = measure(pair, k, np.full(len(k), near))
    return values


def least_between(
    times: FloatArray,
    values: FloatArray,
    change: FloatArray,
    floor: float,
    measure: Callable[[Indices, Indices, FloatArray], FloatArray],
) -> Least | None:
    """What is broken, or cannot be proven kept, between instants; None: nothing.

    Parameters
    ----------
    times : ndarray, shape (K,)
        Instants [s].
    values : ndarray, shape (m, K)
        Clearances there, at least `floor` [m].
    change : ndarray, shape (m, K - 1)
        The most that a clearance can change from one instant to the next, and as an even share of it in a
        part of that time [m].
    floor : float
        What is kept [m].
    measure : callable
        Clearances (V,) of pairs (V,), so many seconds (V,) after instants (V,).
    """
    bound = 0.5 * (values[:, :-1] + values[:, 1:] - change)
    pair, k = np.nonzero(bound < floor)
    first, last = values[pair, k], values[pair, k + 1]
    begin, length, change = np.zeros(len(k)), np.diff(times)[k], change[pair, k]
    measured = 0
    for _ in range(_HALVINGS):
        if not k.size:
            return None
        measured += k.size
        if measured > _MOST:
            break
        middle = begin + 0.5 * length
        found = measure(pair, k, middle)
        worst = int(np.argmin(found))
        if found[worst] < floor:
            return Least(
                float(found[worst]), int(pair[worst]), float(times[k[worst]] + middle[worst]), times[:0]
            )
        change, length = 0.5 * change, 0.5 * length
        halves = [(first, found, begin), (found, last, middle)]
        kept = [0.5 * (a + b - change) < floor for a, b, _ in halves]
        first, last, begin = (
            np.concatenate([half[i][keep] for half, keep in zip(halves, kept, strict=True)]) for i in range(3)
        )
        pair, k = (np.concatenate([one[keep] for keep in kept]) for one in (pair, k))
        length, change = (np.concatenate([one[keep] for keep in kept]) for one in (length, change))
    low = 0.5 * (first + last - change)
    worst = int(np.argmin(low)) if low.size else 0
    if not low.size:
        return None
    return Least(float(low[worst]), int(pair[worst]), float(times[k[worst]] + begin[worst]), times[:0])
