"""The limit on distances within the arm, from the arm to the base, and from both to obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, one_of, pose, set_frozen
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import MODES, BodyStack, clearance_stack
from ffsms_pin.geometry.convex_parts import convex_shape, part_of
from ffsms_pin.geometry.distances import ClearanceStack, Entries, Nearest, Poses, least_of
from ffsms_pin.geometry.obstacle import Obstacle, named
from ffsms_pin.opt.derivatives import Variable, Variables
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows, Violation, stacked
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.options import NotNegative, OneOf, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import apply, cross, dot

_BODY_MARGIN = 3e-3  # [arm lengths] safety margin between bodies, see `Clearance.margin`
_BINDING = 1e-3  # [m] the limit is active if a distance exceeds clearance and margin by less than this
_STEP = 1e-3  # [s] step of finite differences for the velocity of a moving obstacle


@dataclass(frozen=True, eq=False)
class Clearance(Limit):
    """The least distances within the arm, from the arm to the base, and from both to obstacles.

    Raises
    ------
    InvalidValue
        If the collision mode is unknown, the clearance is negative or not a number, or an obstacle or the
        payload is invalid.
    """

    clearance: Annotated[NotNegative, Unit("m")] = 0.01
    """The least distance within the arm (the paper's d_safe), to the base and to obstacles."""
    collision: Annotated[str, OneOf(MODES), Unit()] = "auto"
    """The geometry of the robot: "points", the joints' origins, the end effector and the base's box, as in
    the paper (const4 to const7); "hulls", the URDF's collision shapes as convex parts; "shapes", the exact
    shapes, which take much longer; "off", none; "auto", "hulls" if bodies with shapes can collide, else
    "points". For an arm whose joints are all revolute and parallel, "auto" is always "points". The clearance
    to obstacles is measured from the exact shapes with "shapes", and from the convex parts with "hulls",
    "auto" and "off". With "points", or if the arm has no shapes, it is measured from the lines between the
    points and from the base's box. If convex parts are too near in a finished motion, the distance between
    the exact shapes decides."""
    margin: float = 0.01
    """The safety margin of whole motions during a search [arm lengths], in addition to the clearance. With
    "hulls" or "shapes" it is 3e-3, because neighbouring bodies are close in every posture."""
    obstacles: Sequence[Obstacle] = ()
    """The obstacles."""
    payload: tuple[Any, Any] | None = None
    """The grasped convex shape (coal), and its pose (pinocchio.SE3) in the end-effector frame. The shape
    moves with the body that carries the end effector. The distances between "points" ignore it."""
    name = "clearance"
    rate, step_margin, softness = 2.0, 2e-3, 1.0
    blocks = True
    refusal = "the start violates the clearance: {note}; move the start, or reduce the clearance"
    # The pairs of the robot's bodies, and the pairs of bodies and obstacles.
    _stacks: tuple[ClearanceStack, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        at_least_zero("clearance", self.clearance, "m")
        one_of("collision", self.collision, MODES)
        set_frozen(self, obstacles=named("obstacles", self.obstacles))
        if self.payload is not None:
            if not isinstance(self.payload, tuple) or len(self.payload) != 2:
                raise InvalidValue(
                    "payload", self.payload, "must be a tuple of a coal shape and its pinocchio.SE3"
                )
            shape, placed = self.payload
            set_frozen(self, payload=(convex_shape("payload[0]", shape), pose("payload[1]", placed)))

    def for_robot(self, sms: SpaceManipulator) -> Clearance:
        """Return the limit with the robot's points or shapes."""
        held = None
        if self.payload is not None:
            frame, (shape, placed) = sms.model.frames[sms.frame_id], self.payload
            held = part_of(shape, sms.tip_joint - 2, frame.placement * placed, True)
        stacks = [clearance_stack(sms, self.collision, self.clearance, held)]
        margin = _BODY_MARGIN if isinstance(stacks[0], BodyStack) else self.margin
        if self.obstacles:
            stacks.append(BodyStack(sms, self.collision, self.clearance, held, self.obstacles))
        kept = tuple(stack for stack in stacks if stack is not None and stack.names)
        return replace(self, margin=margin, _stacks=kept)

    @property
    def stacks(self) -> tuple[ClearanceStack, ...]:
        """The pairs of the robot's bodies, and of bodies and obstacles; empty before `for_robot`."""
        return self._stacks

    @property
    def left_out(self) -> list[str]:
        """The ignored pairs of bodies, which are nearer than the clearance by construction."""
        return [name for stack in self._stacks for name in stack.left_out]

    def slack(self, m: Variables) -> list[Variable]:
        """Return distances minus the clearance (c, S, K) of all pairs, a variable for each stack."""
        return [self._slack(stack, m) for stack in self._stacks]

    # The class does not derive `rows`, `residual` and `violation` from the slack, as `opt.Inequality` does,
    # because the evaluation of near pairs alone is much faster.

    def _slack(self, stack: ClearanceStack, m: Variables) -> Variable:
        poses = stack.along(m.rollouts)
        every, shape = stack.every(poses), m.rollouts.joints.shape[1:]
        nearest = stack.nearest(poses, every)

        def by_pairs(values: FloatArray) -> FloatArray:
            pairs_last = values.reshape(*values.shape[:-1], -1, len(stack.names))
            return np.moveaxis(pairs_last, -1, 0).reshape(-1, *values.shape[:-1], *shape)

        slopes = _slopes(stack, m, poses, every, nearest)
        value = by_pairs(nearest.distance) - self.clearance
        return Variable(value, {name: by_pairs(slope) for name, slope in slopes.items()}, m.where)

    def rows(self, step: StepState) -> Rows | None:
        """Return rows that bound the rate at which each distance decreases by `rate` times its slack."""
        return stacked([self._rows(stack, step) for stack in self._stacks])

    def _rows(self, stack: ClearanceStack, step: StepState) -> Rows:
        kept, (least, greatest) = self.clearance + self.step_margin, step.bounds
        poses, moved = stack.at(step.q, step.time_offset + step.time), None
        near: FloatArray | float = np.inf
        if stack.reaches is not None:
            fastest = np.maximum(greatest, -least)
            closing = stack.reaches.dot(fastest)
            if stack.obstacles and stack.passes.any():
                moved = _Passing(stack, step, poses)
                closing += moved.fastest(fastest)
            # At larger distances a row is satisfied even at the fastest joint rates.
            near = kept + closing / self.rate
        every = stack.every(poses)
        nearest = stack.nearest(poses, every, near)
        slopes, placed = stack.slopes(poses, every, nearest)
        G, least = slopes.T, self.rate * (kept - nearest.distance)
        if moved is not None:
            by = moved.slopes(placed)
            G, least = G + by[:, :-1], least - by[:, -1]
        return Rows(G, least, np.full(len(least), UNBOUNDED), self.softness)

    def residual(self, m: Variables) -> list[Variable]:
        """Return the violation of clearance plus margin by the pairs below it, in arm lengths."""
        length, required, residuals = m.stack.length, self.clearance + m.extra_margin, []
        for stack in self._stacks:
            # Bodies that are close in every posture have a smaller margin.
            kept = np.minimum(required + self.margin * length, 0.5 * (required + stack.largest))
            poses = stack.along(m.rollouts)
            entries, nearest = stack.below(poses, kept)
            if nearest.distance.size:
                by = _slopes(stack, m, poses, entries, nearest)
                slopes = {name: -slope[..., None, :] / length for name, slope in by.items()}
                value = (kept[entries[0]] - nearest.distance)[None] / length
                where = np.unravel_index(entries[1], m.rollouts.joints.shape[1:])
                residuals.append(Variable(value, slopes, (where[0], where[1])))
        return residuals

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest violation at nodes and midpoints, for a `BodyStack` also between them."""
        near = self.margin * motion.stack.length + _BINDING
        minima = [(least_of(stack, motion, self.clearance, near), stack) for stack in self._stacks]
        if not minima:
            return Violation()
        instants = np.unique(np.concatenate([least.near for least, _ in minima]))
        broken = [minimum for minimum in minima if self.clearance - minimum[0].value > minimum[1].tolerance]
        worst, stack = min(broken or minima, key=lambda minimum: minimum[0].value)
        pair, distance = stack.names[worst.pair], 1e3 * worst.value
        how = "come no nearer than" if broken and not worst.exact else "come within"
        kept = Violation(0.0, instants, nearest=f"{pair}, which {how} {distance:.1f} mm")
        if not broken:
            return kept
        what = "violated: {} is" if worst.exact else "not proven: {} is at least"
        required = f"{1e3 * self.clearance:.1f} mm are required"
        note = f"a clearance is {what.format(pair)} {distance:.1f} mm at {worst.time:.3g} s, {required}"
        deep = -1e3 * (worst.value + stack.margins[worst.pair]) if stack.obstacles else 0.0
        overlap = f"{pair} overlap by {deep:.1f} mm" if deep > 0.0 and worst.exact else ""
        amount = max(self.clearance - worst.value, abs(stack.tolerance))
        return kept._replace(amount=amount, note=note, overlap=overlap)

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return no violation, because `opt.flown.judge` checks the least clearance of all pairs."""
        return Violation()


def _slopes(
    stack: ClearanceStack, m: Variables, poses: Poses, entries: Entries, nearest: Nearest
) -> dict[str, FloatArray]:
    """Return the slopes (..., V) of the distances of V entries, each a pair of bodies at an instant."""
    gradients, placed = stack.slopes(poses, entries, nearest)
    slopes = {"by_joints": gradients}
    if stack.obstacles:
        # The nearest point of the body moves with the base, that of an obstacle in space does not.
        R = m.rollouts.base_attitude.reshape(3, 3, -1)[..., entries[1]]
        normal = stack.passes[entries[0]] * apply(R, placed[2])
        lever = apply(R, placed[0] - m.rollouts.stack.base_com[:, None])
        slopes |= {"by_base": -normal, "by_base_turn": -cross(lever, normal)}
        if m.step is not None:
            slopes["by_time"] = _Passing(stack, m.step, poses).own_slopes(placed)
    return slopes


class _Passing:
    """The motion of obstacles relative to the base in a step, due to the motions of base and obstacles."""

    def __init__(self, stack: ClearanceStack, step: StepState, poses: Poses) -> None:
        index = stack.bodies[:, 1] - stack.sms.n
        self._passes, self._far = stack.passes, stack.sizes[:, 1]
        # The twist of the base (6, n + 1) per joint rate; the last column is the twist due to the momentum.
        self._base = np.column_stack([step.reaction, step.drift])
        self._turns, self._origins = poses.turns[:, :, index, 0], poses.origins[:, index, 0]
        self._velocity, self._rotating = np.zeros_like(self._origins), np.zeros_like(self._turns)
        if any(obstacle.moves for obstacle in stack.obstacles):
            now = step.time_offset + step.time
            before, after = (stack.at(step.q, now + h) for h in (-_STEP, _STEP))
            self._velocity = (after.origins - before.origins)[:, index, 0] / (2.0 * _STEP)
            self._rotating = (after.turns - before.turns)[:, :, index, 0] / (2.0 * _STEP)

    def fastest(self, rates: FloatArray) -> FloatArray:
        """Return bounds (m,) [m/s] on the speeds of obstacles in base axes, for absolute `rates` (n,)."""
        linear, angular = (np.linalg.norm(part, axis=0) for part in (self._base[:3], self._base[3:]))
        away = np.linalg.norm(self._origins, axis=0) + self._far
        speeds = (linear + away[:, None] * angular) @ np.append(rates, 1.0)
        own = np.linalg.norm(self._velocity, axis=0)
        own = own + self._far * np.linalg.norm(self._rotating, axis=(0, 1))
        return np.asarray(self._passes * (speeds + own))

    def slopes(self, placed: FloatArray) -> FloatArray:
        """Return the rates of distances due to the motions of base and obstacles (m, n + 1) per joint rate.

        The last column is the rate with the joints at rest.
        """
        here, _, normal = placed
        by = -np.concatenate([normal, cross(here, normal)]).T @ self._base
        by[:, -1] += self.own_slopes(placed)
        return np.asarray(self._passes[:, None] * by)

    def own_slopes(self, placed: FloatArray) -> FloatArray:
        """Return the rates of distances (m,) due to the obstacles' own motion."""
        _, there, normal = placed
        local = apply(self._turns.transpose(1, 0, 2), there - self._origins)
        return np.asarray(self._passes * dot(normal, self._velocity + apply(self._rotating, local)))
