"""Re-planning to a client, or along a path on it, with camera measurements during the motion."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.capture.camera import Camera, measured
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client
from ffsms_pin.client.client import carried, other_motion
from ffsms_pin.opt import Clearance, Goal, Obstacle, Path, Problem, Replanning
from ffsms_pin.robot import SpaceManipulator

_QUIET, _FEW = 20, 5  # largest and least number of momentum changes in the estimate of the noise
_LEAST = 1e-4  # [N s, N m s] smallest detected push


def with_client(problem: Problem, client: Client) -> Problem:
    """Return a problem with another client in its goal and obstacles.

    The goal is an `opt.Meet` or an `opt.Path` on a client.
    """
    goal = problem.goal
    goal = replace(goal, frame=client) if isinstance(goal, Path) else replace(goal, client=client)
    limits = [
        replace(limit, obstacles=rebound(limit.obstacles, client), _stacks=())
        if isinstance(limit, Clearance)
        else limit
        for limit in problem.limits
    ]
    return replace(problem, goal=goal, limits=limits)


def rebound(obstacles: Sequence[Obstacle], client: Any) -> list[Obstacle]:
    """Return the obstacles, with those on the client placed on `client`, such as the client's estimate."""
    placed: dict[int, Obstacle] = {}
    for obstacle in obstacles:
        whole = None if obstacle.piece_of is None else placed.get(id(obstacle.piece_of), obstacle.piece_of)
        placed[id(obstacle)] = replace(obstacle, on=client, piece_of=whole) if obstacle.moves else obstacle
    return list(placed.values())


def grasp_at(goal: Goal) -> Callable[[float], FloatArray]:
    """Return the position (3,) [m] of a goal on a client as a function of time [s]."""
    return lambda t: goal.places(np.array([t])).position[:, 0]


class VisualReplanning(Replanning):
    """A `Replanning` to a client that a camera measures with noise and latency.

    `client` is the true client. The goal of the problem is an `opt.Meet` of the `estimate`, or an `opt.Path`
    on the estimate. Each accepted measurement updates the estimate. A path always moves with the estimate.

    In a plan to meet the client, goal and obstacles use the new estimate in the second half of the time. In
    the first half, the new estimate is used only if it changes the position or the attitude of the grasp at
    the deadline by more than one standard deviation, because plans would otherwise follow noise. No
    measurement arrives in the last second before the deadline, because later corrections leave a velocity
    error and the gripper hides the markers.
    """

    def __init__(
        self, problem: Problem, client: Client, sensor: Camera, estimate: ClientEstimate, **others: Any
    ) -> None:
        super().__init__(problem, **others)
        self.estimate, self._planned_for, self._assumed = copy(estimate), estimate, estimate.client()
        self._client, self._sensor = client, sensor
        self._follows = isinstance(problem.goal, Path)
        self._rng = np.random.default_rng((sensor.seed, 1))
        self._look, self.until = sensor.period, problem.duration - (0.0 if self._follows else 1.0)
        # Times [s], true poses and true twists of the client, from the last measurement on.
        self._moves = [(0.0, client.start_pose, client.start_twist)]
        self._sense = MomentumSense(problem)
        self._pushes: list[Push] = []  # pushes later than the last measurement

    @cached_property
    def _target(self) -> Callable[[float], FloatArray]:
        """The position (3,) of the goal on the true client in free motion, as a function of time [s]."""
        return grasp_at(self.task.goal)

    def sees(self, t: float, pose: Any, twist: FloatArray) -> None:
        """Store the client's true pose (pinocchio.SE3) and twist (6,) at t [s], for later measurements."""
        self._moves.append((t, pose, twist))

    @property
    def task(self) -> Problem:
        """The problem with the true client."""
        return with_client(self.problem, self._client)

    @property
    def target(self) -> Any:
        """The true position (3,) [m] of the goal as a function of time [s]; recorded errors refer to it."""
        return self._grasp_at

    def _grasp_at(self, t: float) -> FloatArray:
        since, pose, twist = self._moves[-1]
        if since == 0.0:  # no call of `sees` after the start: the client moves freely
            return self._target(t)
        place, moving = carried(pose, twist, self.problem.goal.grasp)
        there: FloatArray = place.translation + (t - since) * moving[:3]
        return there

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Measure the client if a measurement is due, then re-plan if a planning step is due."""
        self.look(t, q, v)
        super().observe(t, q, v)

    def look(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Measure the client if a measurement is due at t [s]; after `until` [s] there are no measurements.

        q (nq,) and v (6 + n,) are the robot's measured state, from which pushes on the client are estimated.
        """
        if t < self._look - 1e-9:
            return
        self._look += self._sensor.period
        if self.base_mode.endswith("floating"):
            place = self.estimate.pose(t).translation
            push = self._sense.felt(t, q, v, self._planner.robot, self._wheels, place, self.pushed)
            if push is not None:
                self._pushes.append(push)
                self._planned_for.pushed(*push)
        then = t - self._sensor.latency
        if t <= self.until + 1e-9 and self._sensor.sees(then, self._rng):
            while len(self._moves) > 1 and self._moves[1][0] <= then + 1e-9:
                self._moves.pop(0)
            since, *motion = self._moves[0]
            client = other_motion(self._client, *motion)
            while self._pushes and self._pushes[0].time <= then + 1e-9:
                push = self._pushes.pop(0)
                self.estimate.pushed(*push._replace(time=min(push.time, then)))
            seen = measured(client, then - since, self._sensor, self._rng, self._assumed)
            self.estimate.observe(seen, then)
            self._renew(t)

    def _renew(self, t: float) -> None:
        if self._follows or self._differs(t):
            self._planned_for.take(self.estimate)
            for push in self._pushes:
                self._planned_for.pushed(*push)

    def _differs(self, t: float) -> bool:
        """Return whether plans made from t [s] on use the new estimate."""
        deadline, grasp = self.problem.duration, self.problem.goal.grasp
        before, now = (client.pose(deadline) * grasp for client in (self._planned_for, self.estimate))
        off = np.linalg.norm(pin.log6(before.actInv(now)).vector.reshape(2, 3), axis=1)
        known = self.estimate.deviation(deadline, float(np.linalg.norm(grasp.translation)))
        return 2.0 * t > deadline or bool((off > known).any())


class Push(NamedTuple):
    """A time [s], an impulse, an angular impulse and their noise, as for `ClientEstimate.pushed`."""

    time: float
    impulse: FloatArray
    turn: FloatArray
    noise: tuple[float, float]


class MomentumSense:
    """An estimator of pushes on a client from changes of the servicer's momentum.

    Joint motions do not change the momentum of a floating servicer; a contact does. Measured changes of the
    momentum have noise, and a drift if masses deviate from the model. Noise and drift are estimated from the
    last changes without a push. If a contact is possible, changes that deviate from the drift by more than
    four times the noise, and by more than a small threshold, are pushes.
    """

    def __init__(self, problem: Problem) -> None:
        self._wheels, self._robot = problem.wheels, problem.sms
        self._last: FloatArray | None = None
        self._quiet: deque[FloatArray] = deque(maxlen=_QUIET)

    def felt(
        self,
        t: float,
        q: FloatArray,
        v: FloatArray,
        robot: SpaceManipulator,
        wheel_momentum: FloatArray | None,
        place: FloatArray,
        touching: bool,
    ) -> Push | None:
        """Return the push on the client since the last call; None if no push is detected.

        Parameters
        ----------
        t, q, v : float, ndarray
            Time [s] and measured state of the servicer.
        robot : SpaceManipulator
            The servicer with its estimated masses.
        wheel_momentum : ndarray, shape (w,), optional
            Momenta of the wheels that hold the attitude [N m s].
        place : ndarray, shape (3,)
            The client's centre of mass [m].
        touching : bool
            True if a contact is possible.
        """
        state, spinning = robot.at(q, v), np.zeros(3)
        if self._wheels is not None and wheel_momentum is not None:
            spinning = pin.XYZQUATToSE3(q[:7]).rotation @ self._wheels.total(wheel_momentum)
        linear, angular = state.momentum.reshape(2, 3)
        momentum = np.concatenate([linear, angular + np.cross(state.com, linear) + spinning])
        before, self._last = (self._last if robot is self._robot else None), momentum
        self._robot = robot
        if before is None:
            return None
        lost = before - momentum
        if len(self._quiet) < _FEW:
            self._quiet.append(lost)
            return None
        drift, noise = np.mean(self._quiet, axis=0), np.std(self._quiet, axis=0).reshape(2, 3)
        sizes, push = np.linalg.norm(noise, axis=1), (lost - drift).reshape(2, 3)
        beyond = np.linalg.norm(push, axis=1) > np.maximum(4.0 * sizes, _LEAST)
        if not (touching and beyond.any()):
            self._quiet.append(lost)
            return None
        per_axis = (sizes / np.sqrt(3.0)).tolist()
        return Push(t, push[0], push[1] - np.cross(place, push[0]), (per_axis[0], per_axis[1]))
