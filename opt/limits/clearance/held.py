"""A client that the end effector holds, kept from the servicer's other bodies, and these from each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, instance
from ffsms_pin.opt.limits.clearance.bodies import Body, BodyStack, chosen_mode, robot_bodies
from ffsms_pin.opt.limits.clearance.clearance import clearance_stack, named
from ffsms_pin.opt.limits.clearance.distances import ClearanceStack, Poses
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.convex_parts import part_of

_STEPS, _FARTHEST = 40, 0.1  # of the search for a clear posture, and [rad or m] how far one goes
_BESIDE = 5e-3  # [m] by which it looks for more than is asked


class HeldClient:
    """The shapes of a client in the hand, and how far they and the servicer's bodies are apart.

    Parameters
    ----------
    sms : SpaceManipulator
        The servicer.
    shapes : sequence of Obstacle
        The client's, as the approach kept clear of them: their poses are in the client's axes.
    clearance : float
        That is asked for [m]; an obstacle's own margin comes on top.
    collision : str
        As for `opt.Clearance`.
    q : ndarray, shape (nq,)
        Configuration in which the client is held.
    pose : pinocchio.SE3
        Of the client then; it is kept from all bodies but the one that holds it.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        shapes: Sequence[Obstacle],
        clearance: float,
        collision: str,
        q: FloatArray,
        pose: Any,
    ) -> None:
        shapes = named("shapes", shapes)
        instance("sms", sms, SpaceManipulator)
        self.clearance, self._sms = at_least_zero("clearance", clearance, "m"), sms
        frame = sms.model.frames[sms.frame_id]
        in_link = frame.placement * sms.at(q).end_effector_pose.inverse() * pose
        mode = chosen_mode(sms) if collision == "auto" else collision
        held = _HeldStack(sms, mode, [(one, in_link * one.pose) for one in shapes])
        own = clearance_stack(sms, mode, clearance)
        self._stacks = [one for one in (held, own) if one is not None and one.names]

    def least(self, joints: FloatArray) -> tuple[float, str]:
        """The client's least distance [m] at joint positions (K, n), less its margin, and from what.

        That of two of the servicer's own bodies, where it is less than it and than what is asked for.
        """
        poses, found = Poses.of(joints.T), [(np.inf, "")]
        for stack in self._stacks:
            near = np.inf if isinstance(stack, _HeldStack) else self.clearance
            least = stack.values(poses, near).min(axis=1) - stack.margins
            if near == np.inf or least.min() < near:
                found.append((float(least.min()), stack.names[int(np.argmin(least))]))
        return min(found)

    def away(self, joints: FloatArray, more: float = 0.0) -> FloatArray:
        """A posture (n,) near another in which the client is clear by more than is asked for [m].

        If none is found, the last tried.
        """
        limits = self._sms.limits
        for _ in range(_STEPS):
            poses, slopes, lacks = Poses.of(joints[:, None]), [], []
            for stack in self._stacks:
                asked = self.clearance + _BESIDE + (more if isinstance(stack, _HeldStack) else 0.0)
                entries, found = stack.below(poses, asked + stack.margins)
                slopes.append(stack.slopes(poses, entries, found)[0])
                lacks.append(asked + stack.margins[entries[0]] - found.distance)
            if not sum(map(len, lacks)):
                break
            step = np.linalg.pinv(np.hstack(slopes).T, rcond=1e-3) @ np.concatenate(lacks)
            step *= min(1.0, _FARTHEST / float(np.abs(step).max(initial=_FARTHEST)))
            joints = np.clip(joints + step, limits.lower, limits.upper)
        return joints


class _HeldStack(BodyStack):
    """Pairs of a shape in the hand and every body of the robot but the hand."""

    def __init__(self, sms: SpaceManipulator, mode: str, held: Sequence[tuple[Obstacle, Any]]) -> None:
        ClearanceStack.__init__(self, sms)
        self.mode, self._refines, hand = mode, False, int(sms.model.frames[sms.frame_id].parentJoint) - 2
        shapes = [Body.of(one.name, part_of(one.shape, hand, place, True)) for one, place in held]
        own = [one for one in robot_bodies(sms, mode, []) if one.carrier != hand]
        self._take([(one, shape) for one in own for shape in shapes])
        self.margins = np.tile([one.margin for one, _ in held], len(own))
