"""A reference that re-plans from the measured state: a receding horizon."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, at_least_zero, per_joint, vector
from ffsms_pin.opt.derivatives import BASE
from ffsms_pin.opt.goals.goal import Goal
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.correctable import Correctable
from ffsms_pin.opt.replan.learning import Learner, ModelledLaw
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.path_tracking import PathTracker, check_options
from ffsms_pin.opt.replan.rest import JointPlan, RestPlanner
from ffsms_pin.opt.rollouts import wheel_total
from ffsms_pin.opt.step.stepper import Stepper, StepWeights
from ffsms_pin.opt.step.stepwise import REFERENCE_WEIGHTS
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.references import Observer
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.threads import OneThread

# [s] Corrections after the deadline of a fixed goal end if the least error is older than this and the error
# has more than doubled.
_PATIENCE = 2.0
# [rad or m] After the deadline of a fixed goal, the command stops while a joint lags behind it by more than
# this. Otherwise the joint would overshoot.
_LAG = 0.05
# [margins] The largest residual of a limit in a plan to a fixed goal that is followed. For the clearance
# between bodies this is 9 mm per metre of the arm.
_BROKEN = 3.0
_RETURN = 1.0  # [1/s] the gain of the return to the best posture


class Replanning(Observer):
    """A joint motion to a goal that is re-planned from the measured state during the motion.

    A closed loop calls `observe` with its measurements, then `sample`. Every `ReplanOptions.period` the rest
    of the motion is planned again, warm-started by the rest of the last plan. The initial state has the
    measured base pose, but the commanded joint positions and rates, which satisfy the limits and do not jump.
    The model has the estimated masses and the wheel momenta of `observe_wheels`; failed joints are locked at
    their measured positions. Between re-plans, the arm follows the plan. After the deadline, each step moves
    the end effector straight to the goal from the measured state, unless the plan misses the goal by more
    than 1 cm.

    A `Path` is followed by resolved rates near the first plan (`PathTracker`), with the newest estimate of a
    client to which the path is fixed. For a path the options are `period`, `jerk` and `arrived_miss`; other
    options and `weights` raise `InvalidValue`. Here `period` is the time between two updates of the masses.

    Parameters
    ----------
    problem : Problem
        The problem of the motion, which begins in the first measured state.
    hold : float
        Time for which the goal is held after the deadline [s]. `duration` includes it.
    plan : Trajectory, optional
        The first plan. Default: a search from the first measured state.
    options : ReplanOptions, optional
        The options of re-planning.
    weights : StepWeights, optional
        The weights of single steps.
    learn : Learner, optional
        An `identification.Identifier`. Plans use its estimate when the estimate is accurate enough. Default:
        `ScaleFactors`, which estimates factors on the masses and inertias of the arm's bodies and on the
        base's inertia.
    law : ModelledLaw, optional
        The control law of the run. Its model `law.sms` is replaced by the estimated robot. Default: none.

    Attributes
    ----------
    pushed : bool
        True during a possible contact with the end effector, set by the caller. During this time masses are
        not estimated.
    failed_steps, failed_in_a_row : int
        The number of steps in which the arm braked because the step was not solved, in total and since the
        last solved step.
    held_steps : int
        The number of steps in which the arm was stopped, because the new plan violates a limit by far.
    """

    replans = True

    def __init__(
        self,
        problem: Problem,
        hold: float = 0.0,
        plan: Trajectory | None = None,
        options: ReplanOptions | None = None,
        weights: StepWeights | None = None,
        learn: Learner | None = None,
        law: ModelledLaw | None = None,
    ) -> None:
        n = problem.sms.n
        self.problem, self.options, self.learn = problem, options or ReplanOptions(), learn
        self.law = law
        self.duration = problem.duration + at_least_zero("hold", hold, "s")
        self.momentum, self.base_mode = problem.momentum, problem.mode
        self._on_path: PathTracker | None = None
        if isinstance(problem.goal, Path):
            check_options(self.options, weights)
            self._on_path = PathTracker(problem)
        weights = REFERENCE_WEIGHTS if weights is None else weights
        self._stepper = Stepper.of(problem, "resolved-rate", weights)
        self._planner = RestPlanner(problem, self.options, plan, learn)
        self._followed_momentum = problem.momentum
        if problem.locked:
            self._renew_stepper()
        followed = "another thread follows this Replanning, which has the state of one motion only; "
        self._thread = OneThread(f"{followed}make one for each run: opt.Replanning(problem)", for_good=True)
        self._step, self._now, self._seen, self._rests = -1, 0.0, problem.q0, False
        self._start, self._rates = problem.joints0, problem.joint_rates.copy()
        self._accelerations = np.zeros(n)
        self.failed_steps = self.failed_in_a_row = self.held_steps = 0
        self.pushed = False
        # `_best`: the least error [m or rad] after the deadline, with its joint positions and its time.
        # `_given_up`: True if these joint positions are held.
        self._best, self._given_up = (np.inf, problem.joints0, problem.duration), False
        self._noise: float | None = None
        self._wheels: FloatArray | None = None
        self._measured: tuple[FloatArray, FloatArray] | None = None
        self._correctable, self._uncorrectable = Correctable(problem.sms, problem.mode), 0.0
        # [s] Time before the deadline in which no re-plan is made. For an exact goal it is longer.
        self._until = max(0.5 if problem.goal.exact else 0.0, 2 * problem.dt)
        self._jerk = None if self.options.jerk is None else per_joint("jerk", self.options.jerk, n)

    def __repr__(self) -> str:
        return f"Replanning({self.problem!r}, every {self.options.period:g} s)"

    @property
    def target(self) -> Any:
        """The target position (3,) [m] of the end effector, or a function of time [s] that returns it."""
        goal, duration = self.problem.goal, self.problem.duration
        if isinstance(goal, Path) and goal.on == BASE:
            return lambda t: goal.place(t).at(self._seen).position
        if goal.moves:
            return lambda t: goal.places(np.array([t])).position[:, 0]
        place = goal.place(duration)  # a place on the base is evaluated at the last measured base pose
        return (lambda t: place.at(self._seen).position) if place.moves_with_base else place.position

    @property
    def task(self) -> Problem:
        """The problem whose goals and limits are checked in the flown motion."""
        return self.problem

    @property
    def expected_miss(self) -> float:
        """The predicted distance to the goal at the deadline, including the uncorrectable part [m].

        It is infinite before the first plan.
        """
        plan = self._planner.current
        return np.inf if plan is None else math.hypot(plan.miss, self._uncorrectable)

    @property
    def robot(self) -> SpaceManipulator:
        """The robot with the present estimate of its masses."""
        return self._planner.robot

    @property
    def shown(self) -> tuple[FloatArray, FloatArray] | None:
        """The information of the motion about scale factors, see `Learner.shown`."""
        return self._planner.learner.shown

    @property
    def computing_time(self) -> float:
        """The computing time of the last plan [s]; zero along a path."""
        return self._planner.computing_time

    @property
    def mode(self) -> Literal["plan", "hold"]:
        """The mode of the present step: "plan" before the deadline, "hold" after the deadline."""
        return "hold" if self.problem.duration - self._now <= 0.5 * self.problem.dt else "plan"

    @property
    def plan_age(self) -> float:
        """The age of the present plan at the last planning step [s]."""
        return self._now - self._planner.made

    @property
    def note(self) -> str:
        """The message about failed joints, a predicted miss, and unsolved steps; empty if there are none."""
        names, failed = self.problem.sms.joint_names, self._planner.failed & self.problem.free
        notes = [f"joint '{names[i]}' has failed" for i in np.flatnonzero(failed)]
        if np.isfinite(self.expected_miss) and self.expected_miss > self.options.arrived_miss:
            notes.append(f"no motion found that arrives; the target is missed by {self.expected_miss:.3g} m")
        if self._given_up:
            notes.append(
                "corrections after the deadline did not converge, so the arm holds the best posture it had"
            )
        if self.held_steps:
            held = self.held_steps * self.problem.dt
            notes.append(f"the arm held still for {held:.3g} s, because the planned motions violate a limit")
        if self.failed_steps:
            notes.append(f"the arm braked in {self.failed_steps} steps that were not solved")
        return "; ".join(notes)

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Plan the next step from the measured state at t [s], and re-plan the rest of the motion if due."""
        with self._thread:
            step = int(t / self.problem.dt + 1e-6)
            if step != self._step:
                self._take(t, step, q, v)

    def _take(self, t: float, step: int, q: FloatArray, v: FloatArray) -> None:
        dt, planner, wheels = self.problem.dt, self._planner, self.problem.wheels
        planner.observe(q, v, self.pushed, t, self._wheels, self._measured)
        self._stepper.momentum = planner.momentum
        if wheels is not None and self._wheels is not None:
            planner.wheel_total = wheel_total(planner.robot, wheels, q, v, self._wheels)
            self._stepper.wheel_total = planner.wheel_total
        if self._step < 0:
            self._start, self._rates = self.problem.sms.layout.positions(q), v[6:].copy()
            self._stepper.reset(base_start=q[:7].copy(), deadline=self.problem.duration)
        else:
            self._start, self._rates, _ = self._after((step - self._step) * dt)
        failed = planner.failed
        self._start = np.where(failed, self.problem.sms.layout.positions(q), self._start)
        self._rates = np.where(failed, 0.0, self._rates)
        self._step, self._now, self._seen = step, step * dt, q.copy()
        now, left = self._now, self.problem.duration - self._now
        if self._on_path is not None:
            if planner.current is None:  # the motion begins in the first measured state
                self.problem = self._on_path.begun(q)
            self._accelerations = (self._along_path(step, q) - self._rates) / dt
            return
        deadline = now if self.problem.goal.moves else self.problem.duration
        goal, self._uncorrectable = self._correctable.goal(self.problem.goal, q, deadline)
        plan, robot = planner.current, planner.robot
        if plan is None or (left > self._until and now >= planner.due - 1e-9):
            plan = planner.plan(now, q, self._start, self._rates, self._accelerations, goal)
            if planner.robot is not robot:
                self._renew_stepper()
        rates, solved = self._stepped(q, plan, goal)
        self.failed_in_a_row = 0 if solved else self.failed_in_a_row + 1
        self.failed_steps += not solved
        rates = np.where(failed, 0.0, rates)
        self._accelerations = (rates - self._rates) / dt

    def _along_path(self, step: int, q: FloatArray) -> FloatArray:
        """Return joint rates (n,) for the end of a step along a path, from the measured q (nq,)."""
        planner, tracker = self._planner, self._on_path
        assert tracker is not None
        if planner.current is None:
            planner.current = tracker.plan(q, planner.given)
        if self._now >= planner.due - 1e-9:
            robot, momentum = planner.robot, planner.momentum
            planner.renew_robot()
            planner.made, planner.due = self._now, self._now + max(self.options.period, self.problem.dt)
            if planner.robot is not robot or momentum is not self._followed_momentum:
                tracker.use(planner.robot, planner.momentum)
                if self.law is not None:
                    self.law.sms = planner.robot
                self._followed_momentum = planner.momentum
        command = self._start, self._rates, self._accelerations
        noisy = self._noise is not None
        rates = tracker.rates(step, q, planner.current, command, planner.failed, noisy)
        smooth = self._stepper.bounded(self._start, self._rates, self._smoothed(rates))
        return np.where(planner.failed, 0.0, smooth)

    def observe_sensors(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Store the unfiltered measured state, for a learner that models the sensors' noise."""
        if self._planner.learner.unfiltered:
            self._measured = q, v

    def observe_wheels(self, momentum: ArrayLike) -> None:
        """Store the measured momenta (w,) of the wheels, relative to the base [N m s].

        Call this method before `observe`. Without it, the momenta of wheels that hold the attitude follow
        from conservation, which ignores unloading by thrusters.
        """
        wheels = self.problem.wheels if self.learn is None else self.problem.sms.wheels
        if wheels is not None:
            self._wheels = vector("momentum", momentum, len(wheels), "N m s")

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return joint positions, rates and accelerations, each (n,), of the last planned step at t [s]."""
        return self._after(t - self._now)

    def ahead(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Return joint positions and rates, each (n,), of the present plan at t [s].

        Before the first plan they are the commanded joint positions and rates.
        """
        plan = self._planner.current
        return self._after(0.0)[:2] if plan is None else plan.sample(t)

    def expect_noise(self, distance: float) -> None:
        """Set the standard deviation [m] of the measured end-effector position."""
        self._noise = distance
        self._planner.noisy = True
        self._planner.learner.expect_noise()

    def observe_robot(self, robot: SpaceManipulator) -> None:
        """Use the robot estimated by the controller from the next re-plan on.

        An `identification.Identifier` as `learn` ignores it, and uses its own estimate.
        """
        self._planner.learner.observe_robot(robot)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Plan without a failed joint (index from 0), which is locked or limp.

        A limp joint is assumed to stay at its measured position, which is updated in every step.
        """
        self._planner.without(joint)
        self._renew_stepper()

    def _stepped(self, q: FloatArray, plan: JointPlan, goal: Goal) -> tuple[FloatArray, bool]:
        """Return joint rates (n,) at the next step's end, and whether the step was solved.

        The rates follow the plan or lead to the goal. A plan within the limits is followed without a QP. The
        QP of a single step has no preview, so it would brake long before a limit is reached, and the motion
        would leave the plan.
        """
        dt, now, options = self.problem.dt, self._now, self.options
        left, rotation, prefer = self.problem.duration - now, None, None
        if plan.excess > _BROKEN and not (goal.exact or goal.moves):
            self.held_steps += 1
            still = self._smoothed(np.zeros_like(self._rates))
            return self._stepper.bounded(self._start, self._rates, still), True
        # A plan that ends more than 1 cm from the goal is followed to its end. A limit or an obstacle keeps
        # this plan from the goal, and would also stop steps straight to the goal.
        if self.mode == "plan" or plan.miss > 1e-2:
            position = goal.place(now).at(q).position
            planned_joints, planned_rates = plan.sample(now + dt)
            displacement = 0.5 * dt * (self._rates + planned_rates)
            # If a limit has led the motion away from the plan, steps return with a gain of 2 /s.
            prefer = planned_rates + 2.0 * (planned_joints - self._start - displacement)
            if plan.excess <= 1.0:
                return self._stepper.bounded(self._start, self._rates, self._smoothed(prefer)), True
        else:
            place = goal.place(now if goal.moves else self.problem.duration)
            step_place = place.aim(self.problem.sms, q)
            position, rotation = step_place.position, step_place.rotation
            if goal.moves and place.velocity is not None:
                # Steps are aimed at a point ahead of the goal, so that the end effector has the goal's
                # velocity v. At the distance d and speed v, a step after the deadline has the speed
                # 2.5 (d - dt v / 2) / (3.25 dt), which is v for d = (3.25 / 2.5 + 0.5) dt v.
                position = position + (3.25 / 2.5 + 0.5) * dt * place.velocity
            if not goal.moves:
                left = left if self._jerk is None else 5.0 * options.settle
                pose = self.problem.sms.at(q).end_effector_pose
                distance = float(np.linalg.norm(position - pose.translation))
                if self._has_given_up(max(place.error(pose, q)), q):
                    back = _RETURN * (self._best[1] - self._start)
                    return self._stepper.bounded(self._start, self._rates, self._smoothed(back)), True
                lag = self.problem.sms.layout.difference(q, self._start)
                if np.abs(lag[~self._planner.failed]).max(initial=0.0) > _LAG:
                    still = self._smoothed(np.zeros_like(lag))
                    return self._stepper.bounded(self._start, self._rates, still), True
                self._rests = options.rests(distance, self._noise, self._rests)
                if self._rests:
                    prefer = np.zeros_like(self._rates)
                elif self._noise is not None:
                    left = max(left, options.settle)
        step = self._stepper.advance(q, self._rates, position, left, rotation, prefer)
        smooth = self._smoothed(step.joint_rates)
        if not np.array_equal(smooth, step.joint_rates):
            step = self._stepper.advance(q, self._rates, position, left, prefer=smooth)
        return step.joint_rates, step.solved

    def _has_given_up(self, error: float, q: FloatArray) -> bool:
        """Return whether corrections after the deadline do not converge, so that the best posture is held.

        If an arm with an unknown payload or limp joints lags behind the command, every step corrects an error
        for which earlier steps have already commanded a correction, and errors grow. `error` [m or rad] is
        the error of this step.
        """
        best, _, since = self._best
        if error < best:
            self._best = error, self.problem.sms.layout.positions(q), self._now
        elif self._now - since > _PATIENCE and error > 2.0 * best + 1e-3 + 3.0 * (self._noise or 0.0):
            self._given_up = True
        return self._given_up

    def _smoothed(self, rates: FloatArray) -> FloatArray:
        """Return the nearest joint rates (n,) within the jerk limit that can still satisfy rate limits."""
        if self._jerk is None:
            return rates
        dt, now, jerk, limit = self.problem.dt, self._rates, self._jerk, self._stepper.sms.limits.velocity
        usual, most = now + dt * self._accelerations, dt * dt * jerk
        down, up = (dt * np.sqrt(2.0 * jerk * np.maximum(limit + sign * now, 0.0)) for sign in (1.0, -1.0))
        rates = np.clip(rates, now - np.maximum(down - most, 0.0), now + np.maximum(up - most, 0.0))
        return np.asarray(np.clip(rates, usual - most, usual + most))

    def _renew_stepper(self) -> None:
        """Use the present estimate of the robot in the stepper, without failed joints, and in `law`."""
        base_start, failed = self._stepper.base_start, self._planner.failed
        robot = self._planner.robot
        if self.law is not None:
            self.law.sms = robot
        if failed.any():
            velocity, acceleration = robot.limits.velocity.copy(), robot.limits.acceleration.copy()
            velocity[failed] = acceleration[failed] = 1e-9  # not zero: QP rows need an interior
            robot = robot.with_limits(replace(robot.limits, velocity=velocity, acceleration=acceleration))
        self._stepper = self._stepper.like(sms=robot)
        self._stepper.reset(base_start=base_start, deadline=self.problem.duration)

    def _after(self, h: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the motion `h` [s] after the start of the planned step; after its end rates are constant."""
        dt, acceleration = self.problem.dt, self._accelerations.copy()
        late = h > dt * (1.0 + 1e-9)
        within = dt if late else h
        rates = self._rates + within * acceleration
        place = self._start + (0.5 * within) * (self._rates + rates) + (h - within) * rates
        return place, rates, np.zeros_like(rates) if late else acceleration
