"""The clearance of a finished motion: at its instants, and proven between them.

Over an interval a distance changes by no more than the joints' way times their reach, and by what the
obstacle moves and turns as the base sees it. Where that leaves in question what is asked, the interval is
halved: down to the instants, and further where a clearance is not proven to be kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.geometry.distances import ClearanceStack, JointMotion, Poses

_STRIDE = 16  # of the instants that are measured first
_MOST = 5000  # clearances that are measured between instants
# The chord of an obstacle's way from one instant to the next, over which it turns by a few hundredths of a
# radian, is shorter than the way itself by less than this share.
_CHORD = 0.02


class Least(NamedTuple):
    """The least clearance of a motion [m], of which pair, when; and instants (k,) with little left [s].

    A bound from below, and not `found`, where it lies between instants and is neither proven kept nor broken.
    """

    value: float
    pair: int
    time: float
    near: FloatArray
    found: bool = True


def least_of(stack: ClearanceStack, motion: JointMotion, clearance: float, binding: float) -> Least:
    """Return the least clearance of one motion at its instants, and between them if changes are bounded."""
    poses = stack.seen(motion)
    if stack.reaches is not None:
        return _Search(stack, motion, poses, clearance - stack.tolerance, clearance + binding).least()
    values, times = stack.values(poses), motion.times
    which, k = np.unravel_index(int(np.argmin(values)), values.shape)
    close = times[values.min(axis=0) < clearance + binding]
    return Least(float(values[which, k]), int(which), float(times[k]), close)


class _Search:
    """A search for a distance below `floor`, and for instants with a distance below `near` [m].

    A place on the motion is an index of its instants, and between two of them a share further.
    """

    def __init__(self, stack: ClearanceStack, motion: JointMotion, poses: Poses, floor: float, near: float):
        self.stack, self.motion, self.poses = stack, motion, poses
        self.floor, self.near, self.steps = floor, near, np.diff(motion.times)
        self.change = changes(stack, motion, poses)
        self.way = np.pad(np.cumsum(self.change, axis=1), ((0, 0), (1, 0)))
        # How far a base that turns evenly between two instants is from where it is: the error of the angle is
        # at most the change of the angular velocity times the time over 8.
        turn = np.linalg.norm(np.diff(motion.base_angular_velocity[:, 0]), axis=0) * self.steps / 8.0
        self.bend = (stack.passes * (stack.arm.length + stack.sizes[:, 0]))[:, None] * turn
        self.worst = (np.inf, 0, 0.0, True)  # the distance, of which pair, where, and whether it is one
        self.close = np.zeros(len(motion.times), dtype=bool)

    def least(self) -> Least:
        """Halve intervals until all is decided."""
        pairs, count = self.way.shape
        cuts = np.append(np.arange(0, count - 1, _STRIDE), count - 1)
        pair, place = np.tile(np.arange(pairs), len(cuts)), np.repeat(cuts, pairs)
        enough = self.near + 0.5 * np.diff(self.way[:, cuts]).max(axis=1, initial=0.0)
        values = self.measure(pair, place.astype(np.float64), enough[pair])
        # Intervals, a row each: where they begin and end, and the distances there.
        spans = np.stack([place[:-pairs], place[pairs:], values[:-pairs], values[pairs:]], axis=1)
        pair, measured, low = pair[pairs:], 0, np.zeros(0)
        while True:
            change = self.went(pair, spans[:, 1]) - self.went(pair, spans[:, 0])
            low, high = (0.5 * (spans[:, 2] + spans[:, 3] + side * change) for side in (-1.0, 1.0))
            # Between two instants nothing is asked but that the clearance is kept.
            inside = spans[:, 1] - spans[:, 0] > 1.0
            sure = inside & (high < self.near) & (low >= self.worst[0])
            for first, last in spans[sure, :2].astype(np.intp):
                self.close[first:last] = True
            asked = np.where(inside, (low < self.near) & ~sure, low < self.floor)
            done = not inside[asked].any()
            if not asked.any() or (done and self.worst[0] < self.floor):
                break
            pair, spans, change, low = pair[asked], spans[asked], change[asked], low[asked]
            measured += int(np.count_nonzero(~inside[asked]))
            if measured > _MOST:
                which = int(np.argmin(low))
                self.worst = (float(low[which]), int(pair[which]), float(spans[which, 0]), False)
                break
            middle = 0.5 * (spans[:, 0] + spans[:, 1])
            middle = np.where(inside[asked], np.floor(middle), middle)
            distance = self.measure(pair, middle, self.near + 0.5 * change)
            before, after = spans.copy(), spans.copy()
            before[:, 1], before[:, 3] = after[:, 0], after[:, 2] = middle, distance
            pair, spans = np.concatenate([pair, pair]), np.concatenate([before, after])
        value, which, at, exact = self.worst
        times = self.motion.times
        when = float(np.interp(at, np.arange(count), times))
        return Least(float(value), int(which), when, times[self.close], exact)

    def went(self, pair: Indices, place: FloatArray) -> FloatArray:
        """Bound the changes of the pairs' distances (V,) from the start to places (V,) [m]."""
        k = np.minimum(place.astype(np.intp), len(self.steps) - 1)
        return np.asarray(self.way[pair, k] + (place - k) * self.change[pair, k])

    def measure(self, pair: Indices, place: FloatArray, near: FloatArray) -> FloatArray:
        """Return the distances (V,) of pairs at places, or lower bounds if they are not below `near` (V,)."""
        stack, k = self.stack, place.astype(np.intp)
        values, most, between = np.empty(len(pair)), np.empty(len(pair)), place > k
        for some in (np.flatnonzero(~between), np.flatnonzero(between)):
            if not some.size:
                continue
            poses, at, lost = self.poses, k[some], np.zeros(len(some))
            if between[some[0]]:
                poses = stack.between(self.motion, at, (place[some] - at) * self.steps[at])
                lost, at = self.bend[pair[some], at], np.arange(len(some))
            distances = stack.nearest(poses, (pair[some], at), near[some] + lost).distance
            low = np.flatnonzero(distances - lost < self.floor)
            distances[low] = stack.refined(poses, (pair[some][low], at[low]), distances[low])
            values[some], most[some] = distances - lost, distances + lost
        self.close[k[(values < self.near) & ~between]] = True
        least = int(np.argmin(values))
        if values[least] < self.worst[0]:
            self.worst = (values[least], pair[least], place[least], bool(most[least] < self.floor))
        return values


def changes(stack: ClearanceStack, motion: JointMotion, poses: Poses) -> FloatArray:
    """Return a bound on the change of distances from one instant of a motion to the next (m, K - 1) [m]."""
    u = motion.rates[:, 0]
    # Rates are linear in between, so no joint goes further than this.
    change = stack.reaches @ (np.diff(motion.times) * np.maximum(np.abs(u[:, :-1]), np.abs(u[:, 1:])))
    if stack.passes.any():
        index = stack.bodies[stack.passes, 1] - stack.sms.n
        far = stack.sizes[stack.passes, 1:]
        # Places and, as chords of points at a unit distance, turns.
        ways = [np.diff(poses.origins[:, index]), np.diff(poses.turns[:, :, index]) / np.sqrt(2.0)]
        bends = [np.diff(displacement) for displacement in ways]
        sweep, bend = (
            np.linalg.norm(a, axis=0) + far * np.linalg.norm(b, axis=(0, 1)) for a, b in (ways, bends)
        )
        # The largest speed exceeds the mean one by half of what a velocity changes in between.
        bend = np.pad(bend, ((0, 0), (1, 1)))
        change[stack.passes] += (1.0 + _CHORD) * sweep + 0.5 * np.maximum(bend[:, 1:], bend[:, :-1])
    return np.asarray(change)
