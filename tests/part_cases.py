"""Define all packaged terms, two custom parts, and limits so tight that a motion violates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from base_actuators import PYRAMID, THRUSTER_DIRECTIONS, THRUSTER_POSITIONS
from clearances_at import least_clearance
from own_parts import AbovePlane, LookAt

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variable
from ffsms_pin.opt.limits.base_limits import BaseLimits
from ffsms_pin.opt.rollouts import Rollouts, rolled_out
from ffsms_pin.opt.step.state import roll_out_steps
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import measure

POINT = (0.3, 1.2, 0.2)
GOAL = np.array([0.7, 0.5, 0.0])
ROBOTS = ("planar_3r", "satellite_panda")

# The weights are large enough that each term differs clearly from the paper's cost.
TERMS: dict[str, opt.Term] = {
    "coupling": opt.Coupling(),
    "soft coupling": opt.Coupling(1.0, 2.0),
    "smooth": opt.Smooth(1.0),
    "effort": opt.Effort(0.01),
    "base turn": opt.BaseTurn(100.0),
    "own": LookAt(POINT, 10.0),
    "wheel momentum": opt.WheelMomentum(3.0),
    "wheel energy": opt.WheelEnergy(3.0, rounding=1e-4),
    "propellant": opt.Propellant(3.0, rounding=1e-4),
    "propellant, place held": opt.Propellant(3.0, rounding=1e-4),
    "propellant, both held": opt.Propellant(3.0, rounding=1e-4),
}
# The base modes of terms and limits that need one.
MODES = {
    "wheel momentum": "rotation-floating",
    "wheel energy": "rotation-floating",
    "wheels' momentum": "rotation-floating",
    "wheels' torque": "rotation-floating",
    "propellant": "rotation-flying",
    "propellant, place held": "translation-flying",
    "propellant, both held": "flying",
}


def with_wheels_and_thrusters(sms: ffsms.SpaceManipulator, **limits: float) -> ffsms.SpaceManipulator:
    """Return the robot with thrusters and with wheels, which are unlimited without `limits`."""
    thrusters = ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 50.0, proportional=True)
    return sms.with_actuators(wheels=ffsms.ReactionWheels(PYRAMID, 0.01, **limits), thrusters=thrusters)


class LimitedQuantities(NamedTuple):
    """The quantities of a motion that limits can restrict."""

    attitude: float
    attitude_rate: float
    translation: float
    final_attitude: float
    least: Callable[[str], float]  # the smallest clearance of points or shapes [m]
    path: FloatArray  # path of the end effector (3, K)
    rates: FloatArray  # largest joint rates (n,)
    base: list[Any]  # poses of the base link (pinocchio.SE3)
    last: FloatArray  # q at the end (nq,)
    torques: FloatArray  # largest joint torques (n,)
    wheels: tuple[float, float]  # largest momentum and torque of a wheel [N m s, N m]


# A function that returns the robot, with tighter limits if needed, and a limit that a motion violates.
TightLimit = Callable[[ffsms.SpaceManipulator, LimitedQuantities], tuple[ffsms.SpaceManipulator, opt.Limit]]


def beside_the_chord(
    sms: ffsms.SpaceManipulator, use: LimitedQuantities
) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
    """Return a plane parallel to the chord, at half of the motion's largest distance from the chord."""
    chord = use.path[:, -1] - use.path[:, 0]
    normal = np.array([-chord[1], chord[0], 0.0]) / np.linalg.norm(chord)
    strayed = normal @ (use.path - use.path[:, :1])
    far = float(strayed[np.argmax(np.abs(strayed))])
    normal = -np.sign(far) * normal
    offset = float(normal @ use.path[:, 0]) - 0.5 * abs(far)
    return sms, AbovePlane((float(normal[0]), float(normal[1]), 0.0), offset)


def slow(sms: ffsms.SpaceManipulator, use: LimitedQuantities) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
    """Return the robot with rate limits of 0.85 times the rates of the motion."""
    return sms.with_limits(replace(sms.limits, velocity=0.85 * use.rates)), opt.JointLimits()


class Drifting:
    """A client that drifts and rotates slowly, and is at `place` at `time`."""

    def __init__(self, place: FloatArray, time: float) -> None:
        self._place, self._time = place, time

    def pose(self, t: float) -> Any:
        turn = pin.exp3(np.array([0.1, -0.2, 0.3]) * (t - self._time))
        return pin.SE3(turn, self._place + np.array([0.002, 0.001, 0.03]) * (t - self._time))

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        poses = [self.pose(t) for t in times.tolist()]
        return np.array([p.translation for p in poses]), np.array([p.rotation for p in poses])


def obstacle_on_path(on: str) -> TightLimit:
    """Return a function that puts a capsule at the middle of the end effector's path, fixed to `on`."""

    def made(sms: ffsms.SpaceManipulator, use: LimitedQuantities) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
        gone = np.linalg.norm(use.path - use.path[:, :1], axis=0)
        middle = len(gone) // 2 if on == "client" else int(np.argmax(gone >= 0.5 * gone[-1]))
        place, shape = pin.SE3(np.eye(3), use.path[:, middle]), coal.Capsule(0.02, 0.05)
        if on == "base":
            obstacle = opt.Obstacle(shape, use.base[middle].actInv(place), "base")
        elif on == "client":
            offset = pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
            obstacle = opt.Obstacle(shape, offset, Drifting(place.translation, 3.0))
        else:
            obstacle = opt.Obstacle(shape, place)
        return sms, opt.Clearance(0.01, "off", obstacles=[obstacle])

    return made


def waypoint_aside(timed: bool, turned: bool = False) -> TightLimit:
    """Return a function that puts a waypoint 0.05 m beside the middle of the path, towards the base."""

    def made(sms: ffsms.SpaceManipulator, use: LimitedQuantities) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
        middle = use.path.shape[1] // 2
        direction = use.base[middle].translation - use.path[:, middle]
        place = use.path[:, middle] + 0.05 * direction / np.linalg.norm(direction)
        time = (3.0 if sms.n == 3 else 4.0) if timed else None
        goal = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.5])), place) if turned else place
        return sms, opt.Waypoint(goal, time=time, reach=0.02 if timed else 0.01)

    return made


ELBOWS = {3: "link_3", 7: "panda_link5"}


def elbow_goal_aside(turned: bool = False) -> TightLimit:
    """Return a function that puts a goal for the elbow 0.05 m beside its final position in the motion."""

    def made(sms: ffsms.SpaceManipulator, use: LimitedQuantities) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
        elbow = frame_pose(sms, use.last, ELBOWS[sms.n])
        direction = elbow.translation - use.path[:, -1]
        across = np.cross([0.0, 0.0, 1.0], direction) / np.linalg.norm(direction)
        place = elbow.translation + 0.05 * across
        goal = opt.Position(place, tolerance=0.03, reach=0.04)
        if turned:
            return sms, opt.FrameGoal(
                ELBOWS[sms.n], pin.SE3(elbow.rotation @ pin.exp3(0.2 * np.ones(3)), place)
            )
        return sms, opt.FrameGoal(ELBOWS[sms.n], goal)

    return made


def frame_pose(sms: ffsms.SpaceManipulator, q: FloatArray, name: str) -> Any:
    """Return the pose (pinocchio.SE3) of a frame by Pinocchio."""
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, q)
    return data.oMf[sms.model.getFrameId(name)].copy()


def weak(sms: ffsms.SpaceManipulator, use: LimitedQuantities) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
    """Return the robot with torque limits of 0.8 times the torques of the motion."""
    return sms.with_limits(replace(sms.limits, torque=0.8 * use.torques)), opt.TorqueLimits()


def weak_wheels(what: str) -> TightLimit:
    """Return a function that limits the wheels to 0.8 of the momentum or torque of the motion."""

    def made(sms: ffsms.SpaceManipulator, use: LimitedQuantities) -> tuple[ffsms.SpaceManipulator, opt.Limit]:
        return with_wheels_and_thrusters(sms, **{what: 0.8 * use.wheels[what == "torque"]}), opt.WheelLimits()

    return made


LIMITS: dict[str, TightLimit] = {
    "joints": slow,
    "attitude": lambda sms, use: (sms, BaseLimits(attitude=0.6 * use.attitude)),
    "attitude_rate": lambda sms, use: (sms, BaseLimits(attitude_rate=0.6 * use.attitude_rate)),
    "translation": lambda sms, use: (sms, BaseLimits(translation=0.9 * use.translation)),
    "final_attitude": lambda sms, use: (sms, BaseLimits(final_attitude=0.5 * use.final_attitude)),
    "points": lambda sms, use: (sms, opt.Clearance(use.least("points") + 0.015, "points")),
    "shapes": lambda sms, use: (sms, opt.Clearance(use.least("shapes") + 0.015, "shapes")),
    "obstacle": obstacle_on_path("inertial"),
    "obstacle on the base": obstacle_on_path("base"),
    "obstacle on a client": obstacle_on_path("client"),
    "via": waypoint_aside(True),
    "via at any time": waypoint_aside(False),
    "also": elbow_goal_aside(),
    "own": beside_the_chord,
    "torques": weak,
    "wheels' momentum": weak_wheels("momentum"),
    "wheels' torque": weak_wheels("torque"),
}


# Single steps do not support a waypoint without a time.
STEPPED = [name for name in LIMITS if name != "via at any time"]
# Limits that are residuals of whole motions, and robots. Shapes of `satellite_panda` would take minutes.
PENALISED = [
    (name, robot)
    for name in LIMITS
    if name != "joints"
    for robot in ROBOTS
    if (name, robot) != ("shapes", ROBOTS[1])
]


def problem_of(sms: ffsms.SpaceManipulator, part: str = "", **change: Any) -> opt.Problem:
    """Return a problem; that of the spatial arm starts with a rotated, displaced base and moving joints.

    The base mode is that of the part with this name.
    """
    if part in MODES:
        change = {"mode": MODES[part], **change}
        sms = with_wheels_and_thrusters(sms) if sms.wheels is None else sms
    if sms.n == 3:
        options: dict[str, Any] = {"goal": GOAL, "duration": 6.0, "dt": 0.02, "limits": [opt.JointLimits()]}
        return opt.Problem(sms, sms.configuration([0.4, 0.7, -0.5]), **(options | change))
    low, high = (np.clip(bound, -2.0, 2.0) for bound in (sms.limits.lower, sms.limits.upper))
    base = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.3]))
    q0 = sms.configuration(0.5 * (low + high) + 0.1, base)
    goal = sms.at(q0).end_effector_pose.translation + np.array([0.2, 0.1, 0.1])
    rates = 0.05 * np.cos(np.arange(sms.n))
    options = {"goal": goal, "duration": 8.0, "dt": 0.05, "joint_rates": rates, "limits": [opt.JointLimits()]}
    return opt.Problem(sms, q0, **(options | change))


def rollout_of(problem: opt.Problem, rates: FloatArray) -> Rollouts:
    """Return the rollout of joint rates at the nodes, with all data that limits and terms read."""
    motion = rolled_out(problem.sms, problem.stack, problem.q0, rates, problem.dt, problem.momentum)
    place = problem.goal.place(problem.duration).position
    target = np.repeat(place[:, None], len(motion.times), axis=1)
    motion = replace(motion, target=target, mean_speed=problem.mean_speed, thrusters=problem.thrusters)
    return replace(motion, wheels=problem.wheels, wheel_total=problem.wheel_total)


def limited_quantities(problem: opt.Problem, rates: FloatArray) -> LimitedQuantities:
    """Compute the limited quantities of a motion from the configurations at the nodes."""
    plan, sms = measure(problem, rates), problem.sms
    motion = rollout_of(problem, rates)
    first = sms.at(problem.q0).base_pose
    poses = [sms.at(q).base_pose for q in plan.q]
    turns = [float(np.linalg.norm(pin.log3(first.rotation.T @ pose.rotation))) for pose in poses]
    return LimitedQuantities(
        max(turns),
        float(np.linalg.norm(plan.v[:, 3:6], axis=1).max()),
        max(float(np.linalg.norm(pose.translation - first.translation)) for pose in poses),
        turns[-1],
        lambda mode: least_clearance(opt.Clearance(0.0, mode).for_robot(sms), motion)[0],
        plan.end_effector.T,
        np.abs(rates).max(axis=0),
        [pin.XYZQUATToSE3(q[:7]) for q in plan.q],
        plan.q[-1],
        largest_torques(sms, plan),
        (
            np.abs(plan.wheel_momentum).max(initial=0.0),
            np.abs(opt.Variables(motion).wheel_torques.value).max(initial=0.0),
        ),
    )


def largest_torques(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> FloatArray:
    """Return the largest joint torques (n,) [N m], by H_q and C_q at the start and the end of every step."""
    largest = np.zeros(sms.n)
    for nodes in (slice(None, -1), slice(1, None)):
        for q, v, acceleration in zip(plan.q[nodes], plan.v[nodes], plan.joint_accelerations, strict=True):
            state = sms.at(q, v)
            largest = np.maximum(largest, np.abs(state.H_q @ acceleration + state.C_q))
    return largest


def size_of(residuals: list[Variable]) -> float:
    """Return the largest residual, zero if there is none."""
    return max((float(np.abs(residual.value).max(initial=0.0)) for residual in residuals), default=0.0)


def rates_of_step_rollout(problem: opt.Problem) -> FloatArray:
    """Return the joint rates of a step rollout with the problem's limits and without terms."""
    stepper = Stepper.of(problem, terms=())
    return roll_out_steps(stepper, problem.q0, problem.joint_rates, GOAL, problem.duration)[0]
