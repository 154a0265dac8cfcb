"""What a finished motion keeps to obstacles: at its instants, and between them.

Between two instants no point of a body goes further than the body's centre goes and the body turns, and
likewise for an obstacle that moves. Where that leaves the clearance in question, the interval is halved
(`least_between`).
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions, apply_rates
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.between import TOLERANCE, Least, along, joints_after, least_between
from ffsms_pin.opt.limits.obstacles.obstacle import Track
from ffsms_pin.opt.limits.obstacles.stack import ObstacleStack, seen_from_base
from ffsms_pin.opt.limits.part_pairs import Poses
from ffsms_pin.system.batch.stacks import apply, cross, exp3, log3

__all__ = ["least_of_obstacles"]

# The chord of an obstacle's way from one instant to the next, over which it turns by a few hundredths of a
# radian, is shorter than the way itself by less than this share.
_CHORD = 0.02


def least_of_obstacles(stack: ObstacleStack, motion: Motions, clearance: float, binding: float) -> Least:
    """The least distance of one motion to obstacles at its nodes, in the middles, and between them."""
    times = motion.times
    poses = stack.seen(motion)
    change = _robot_change(stack, motion, poses) + _obstacle_change(stack, times)
    near, floor = clearance + binding + 0.5 * float(change.max(initial=0.0)), clearance - TOLERANCE
    values = along(change, near, lambda pair, k, near: stack.distances_at(poses, (pair, k), near))
    low = np.nonzero(values < floor)
    if low[0].size:
        values[low] = stack.exact(poses, low, floor)
    which, k = np.unravel_index(int(np.argmin(values)), values.shape)
    close = times[values.min(axis=0) < clearance + binding]
    least = Least(float(values[which, k]), int(which), float(times[k]), close)
    if least.value < floor:
        return least
    bend = _bend(stack, motion)

    def measure(pair: Indices, k: Indices, after: FloatArray) -> FloatArray:
        here = _between(stack, motion, k, after)
        return (
            stack.exact(here, (pair, np.arange(len(pair))), floor + float(bend[pair, k].max()))
            - bend[pair, k]
        )

    between = least_between(times, values, change, floor, measure)
    return least if between is None else between._replace(near=close)


def _robot_change(stack: ObstacleStack, motion: Motions, poses: Poses) -> FloatArray:
    """The most that a distance changes by the robot's motion from one instant to the next (m, K - 1) [m].

    The speed of a body's centre, plus its angular speed times its radius. Speeds are known at both instants;
    half of what velocities change in between is added for their bend.
    """
    arm, u, body = motion.arm, motion.rates[:, 0], stack.bodies
    carries = np.vstack([stack.arm.carries.T, np.zeros(stack.arm.n)])[body]
    count = len(motion.times)
    own = motion.own_spin[:, 0]
    spin = apply_rates(arm.spin[..., 0, :], u) + own
    root = apply_rates(arm.root[..., 0, :], u) + np.einsum(
        "yxk,y->xk", motion.base_attitude[:, :, 0], motion.drift
    )
    root += cross(arm.com[:, 0], own)
    # Of every pair (3, m, K), base axes; what is fixed to the base is not passed by the base's own motion.
    apart = np.where(stack.on_base, 0.0, 1.0)[:, None]
    links = poses.rotations[:, :, body], poses.origins[:, body]
    centre = links[1] + np.einsum("xymk,my->xmk", links[0], stack.centres)
    turning = np.einsum("mj,xjk,jk->xmk", carries, arm.axes[..., 0, :], u)
    sliding = np.einsum("mj,xjk,jk->xmk", carries, arm.velocities[..., 0, :], u)
    turning = turning + apart * spin[:, None]
    velocity = sliding + cross(turning, centre) + apart * root[:, None]
    assert velocity.shape == (3, len(body), count)
    speed = np.linalg.norm(velocity, axis=0) + stack.radii[:, None] * np.linalg.norm(turning, axis=0)
    bend = np.linalg.norm(np.diff(velocity), axis=0)
    bend += stack.radii[:, None] * np.linalg.norm(np.diff(turning), axis=0)
    most: FloatArray = np.maximum(speed[:, 1:], speed[:, :-1]) + 0.5 * bend
    return most * np.diff(motion.times)


def _obstacle_change(stack: ObstacleStack, times: FloatArray) -> FloatArray:
    """The most that a distance changes by the obstacle's own motion (m, K - 1) [m]."""
    change = np.zeros((len(stack.obstacles), len(times) - 1))
    for k, (obstacle, track) in enumerate(zip(stack.obstacles, stack.tracks(times), strict=True)):
        if obstacle.moves:
            way = np.linalg.norm(np.diff(track.positions, axis=0), axis=1)
            turned = np.einsum("kyx,kyz->xzk", track.rotations[:-1], track.rotations[1:])
            far = float(stack.far[stack.others == k].max(initial=0.0))
            change[k] = (1.0 + _CHORD) * (way + far * np.linalg.norm(log3(turned), axis=0))
    return np.asarray(change[stack.others])


def _bend(stack: ObstacleStack, motion: Motions) -> FloatArray:
    """How far a base that turns evenly between two instants is from where it is (m, K - 1) [m].

    The error of the angle is at most the change of the angular velocity times the time over 8.
    """
    turn = np.linalg.norm(np.diff(motion.base_spin[:, 0]), axis=0) * np.diff(motion.times) / 8.0
    reach = stack.arm.length + stack.radii
    return np.asarray(np.where(stack.on_base, 0.0, reach)[:, None] * turn)


def _between(stack: ObstacleStack, motion: Motions, k: Indices, after: FloatArray) -> Poses:
    """Links, obstacles and base `after` (V,) seconds after instants k (V,)."""
    R, share = motion.base_attitude[:, :, 0], after / (motion.times[k + 1] - motion.times[k])
    arm = stack.arm.evaluate(joints_after(motion, k, after))
    turn = log3(np.einsum("yxv,yzv->xzv", R[..., k], R[..., k + 1]))
    here = np.einsum("xyv,yzv->xzv", R[..., k], exp3(share * turn))
    com = motion.com[:, k] + after * motion.drift[:, None]
    tracks: list[Track] = [one.track(motion.times[k] + after) for one in stack.obstacles]
    return seen_from_base(Poses.of(arm), here, com - apply(here, arm.com), stack.obstacles, tracks)
