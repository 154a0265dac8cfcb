"""A planning problem: a frozen object that is validated once, for all solvers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import (
    FloatArray,
    at_least_zero,
    frozen,
    instance,
    matrix,
    names,
    one_of,
    positive,
    vector,
)
from ffsms_pin.client import rest_momentum
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.obstacle import Obstacle
from ffsms_pin.opt.costs import BaseTurn, Coupling, Effort, Smooth, Term
from ffsms_pin.opt.evaluation import check_own_parts, checked_parts
from ffsms_pin.opt.goals.goal import Goal, Place, as_goal
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.joint_limits import JointLimits
from ffsms_pin.opt.limits.limit import Limit, prepared
from ffsms_pin.opt.limits.torque_limits import TorqueLimits
from ffsms_pin.opt.limits.wheel_limits import WheelLimits
from ffsms_pin.opt.rollouts import Rollouts, held_momentum, rolled_out, wheel_shares
from ffsms_pin.options import NotNegative, OneOf, Positive, Texts, Unit, Vector6
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.dynamics import MODES


def default_terms(
    kappa: Annotated[Positive, Unit()] = Coupling.kappa,
    effort: Annotated[NotNegative | None, Unit("", "1e-4")] = None,
    base: Annotated[NotNegative, Unit()] = 0.0,
    coupled: bool = True,
) -> tuple[Term, ...]:
    """Return the default terms of a problem.

    Parameters
    ----------
    kappa : float
        Sharpness of the paper's C~, see `opt.Coupling`. By default C~ is close to max(0, cos(theta_a)).
    effort : float, optional
        Weight of joint rates, see `opt.Effort`; for the method "horizon".
    base : float
        Weight of the base's rotation, see `opt.BaseTurn`; for the method "horizon".
    coupled : bool
        True to include the paper's cost, see `Goal.coupled`.
    """
    cost = (Coupling(kappa),) if coupled else ()
    turn = (BaseTurn(base),) if at_least_zero("base", base) != 0.0 else ()
    return (*cost, Smooth(), Effort() if effort is None else Effort(at_least_zero("effort", effort)), *turn)


def default_limits(
    clearance: float = Clearance.clearance,
    collision: str = Clearance.collision,
    obstacles: Sequence[Obstacle] = (),
    base: Limit | None = None,
) -> tuple[Limit, ...]:
    """Return the limits of joints, torques and clearance, and `base` if it is not None."""
    if not (base is None or isinstance(base, Limit)):
        raise InvalidValue("base_limits", base, "must be an opt.BaseLimits or None")
    limits = (JointLimits(), TorqueLimits(), Clearance(clearance, collision, obstacles=obstacles))
    return limits if base is None else (*limits, base)


def free_momentum(momentum: FloatArray, mode: str) -> FloatArray:
    """Return the part of a total momentum (6,) that a problem accepts in a mode.

    The linear part is accepted if the base's position is free, and the angular part if the whole base is
    free. The other parts are zero in the result.
    """
    free = MODES[mode]
    return np.asarray(momentum * np.repeat([float(0 in free), float(len(free) == 6)], 3))


def step_limits(limits: Sequence[Limit], mode: str = "floating") -> tuple[Limit, ...]:
    """Add the limits of plans by single steps: `AlphaBox`, and `WheelLimits` if wheels hold the attitude."""
    return _with_others(limits, AlphaBox(), *([WheelLimits()] if mode == "rotation-floating" else []))


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem: robot, start, goal, duration, terms and limits.

    Attributes
    ----------
    sms : SpaceManipulator
        The robot.
    q0 : array_like, shape (nq,)
        Configuration at the start, within the joint limits.
    goal : array_like, shape (3,), pinocchio.SE3, callable, or Goal
        The desired pose of the end effector at the deadline: a position [m] or a pose in inertial axes, a
        function of time [s] that returns either, or a goal such as `opt.Pose`, `opt.Path` or `opt.Meet`.
    duration : float
        Time to the deadline [s]. The paper states no duration.
    dt : float
        Step of the finished motion [s]; it is rounded so that the duration is a whole number of steps.
    terms : sequence of Term, optional
        The cost terms. Default: the paper's cost with kappa 10 (unless the goal determines the direction,
        `Goal.coupled`), accelerations, and joint travel.
    limits : sequence of Limit, optional
        The limits. Default: joint limits, torque limits and a clearance of 0.01 m. The goal's own limits are
        added, and `WheelLimits` if wheels hold the attitude.
    joint_rates : array_like, shape (n,), optional
        Joint rates at the start [rad/s]. Default: at rest.
    momentum : array_like, shape (6,), optional
        Total momentum [linear; angular] about the system's centre of mass, inertial axes [kg m/s; kg m^2/s].
        Default: the momentum that the goal requires (`opt.Meet(rest_after=True)`), else zero.
    locked : sequence of str
        Names of joints that cannot move, in the plan and in re-planning.
    mode : str
        The part of the base's motion that is held: none ("floating"), the attitude by wheels
        ("rotation-floating"), the attitude by thrusters ("rotation-flying"), the position of the base's
        centre of mass ("translation-flying"), or both ("flying").
    wheel_momentum : array_like, shape (w,), optional
        Momenta of the wheels at the start, relative to the base [N m s], if wheels hold the attitude.
        Default: zero.
    base_start : array_like, shape (7,), optional
        Root pose (position, quaternion) relative to which base rotation and displacement are measured.
        Default: the root pose in q0.
    time_offset : float
        The time [s] that is added to times of the motion for limits and moving obstacles; set by re-planning.
    extra_margins : dict of str to float
        Additional margins of limits by their names, each in the limit's own unit; set by a search, because
        penalties are soft.
    goal_limits : sequence of Limit
        The limits among `limits` that the goal adds (`Goal.limits`). If `dataclasses.replace` sets
        another goal, the limits of the new goal replace them.

    Raises
    ------
    InvalidValue
        If a shape is wrong, a number is out of range, a joint is unknown, or the start is outside the joint
        limits.
    PartError
        If a user's own term or limit fails, or its formula returns no variables.
    """

    sms: SpaceManipulator
    q0: Any
    goal: Any
    duration: Annotated[Positive, Unit("s")] = 12.0
    dt: Annotated[Positive, Unit("s")] = 0.01
    terms: Sequence[Term] = None  # type: ignore[assignment]  # replaced by the default
    limits: Sequence[Limit] = None  # type: ignore[assignment]
    joint_rates: Any = None
    momentum: Annotated[Vector6 | None, Unit("kg m/s, kg m²/s", "none")] = None
    locked: Annotated[Texts, Unit("", "[]")] = ()
    mode: Annotated[str, OneOf(tuple(MODES)), Unit()] = "floating"
    wheel_momentum: Any = None
    base_start: Any = None
    time_offset: float = 0.0
    extra_margins: Mapping[str, float] = field(default_factory=dict)
    goal_limits: Sequence[Limit] = ()

    def __post_init__(self) -> None:
        instance("sms", self.sms, SpaceManipulator)
        sms, set_field = self.sms, partial(object.__setattr__, self)
        set_field("q0", frozen(sms.checked_configuration("q0", self.q0)))
        duration, dt = positive("duration", self.duration, "s"), positive("dt", self.dt, "s")
        if not 1.0 <= duration / dt <= 1e6:  # a plan of a million steps with seven joints has 0.6 GB
            remedy = (
                f"must be at least one step of {dt:g} s and at most 1000000 steps; adapt the duration or dt"
            )
            raise InvalidValue("duration", duration, remedy)
        set_field("duration", duration)
        set_field("dt", duration / round(duration / dt))
        set_field("goal", as_goal(self.goal).for_motion(sms, self.q0, duration))
        set_field("mode", one_of("mode", self.mode, MODES))
        terms = default_terms(coupled=self.goal.coupled) if self.terms is None else self.terms
        set_field("terms", checked_parts("terms", terms, Term))
        limits = checked_parts("limits", default_limits() if self.limits is None else self.limits, Limit)
        # After `dataclasses.replace`, the goal's earlier limits are replaced.
        own_limits = [limit for limit in limits if not any(limit is earlier for earlier in self.goal_limits)]
        of_goal = self.goal.limits(duration)
        limits = (*own_limits, *of_goal)
        limits = limits if self.wheels is None else _with_others(limits, WheelLimits())
        set_field("limits", tuple(prepared(limit, sms) for limit in checked_parts("limits", limits, Limit)))
        set_field("goal_limits", self.limits[len(own_limits) :][: len(of_goal)])
        set_field("time_offset", at_least_zero("time_offset", self.time_offset, "s"))
        for name, margin in self.extra_margins.items():
            at_least_zero(f"extra_margins['{name}']", margin)
            one_of("extra_margins", name, [limit.name for limit in self.limits])
        rates = np.zeros(sms.n) if self.joint_rates is None else self.joint_rates
        # The bound on rates keeps positions finite.
        set_field("joint_rates", frozen(vector("joint_rates", rates, sms.n, "rad/s", largest=1e4)))
        set_field("locked", names("locked", self.locked, sms.joint_names, "joints"))
        momentum = self.required_momentum if self.momentum is None else vector("momentum", self.momentum, 6)
        momentum = None if momentum is None or not momentum.any() else momentum
        if momentum is not None and (momentum != free_momentum(momentum, self.mode)).any():
            free = MODES[self.mode]
            part = "attitude" if 0 in free else "position" if free else "position and attitude"
            zero = "have no angular part" if 0 in free else "be zero"
            remedy = f"must {zero} in mode '{self.mode}', which holds the base's {part}"
            raise InvalidValue("momentum", momentum, remedy)
        set_field("momentum", None if momentum is None else frozen(momentum))
        wheels, spin_momenta = len(self.wheels or ()), self.wheel_momentum
        if spin_momenta is None or np.size(spin_momenta) == 0:
            spin_momenta = np.zeros(wheels)
        elif not wheels:
            why = "the robot has none" if self.mode == "rotation-floating" else f"mode '{self.mode}'"
            remedy = f"must be left out: no wheels hold the attitude ({why})"
            raise InvalidValue("wheel_momentum", spin_momenta, remedy)
        set_field("wheel_momentum", frozen(vector("wheel_momentum", spin_momenta, wheels, "N m s")))
        if self.base_start is not None:
            set_field("base_start", frozen(vector("base_start", self.base_start, 7)))
        for bounds in (limit.joint_bounds for limit in self.limits if limit.joint_bounds is not None):
            if (outside := bounds.violation(self.joints0)).any():
                i = int(np.argmax(outside))
                name, value = f"q0: joint '{sms.joint_names[i]}'", round(float(self.joints0[i]), 6)
                within = f"[{bounds.lower[i]:.6g}, {bounds.upper[i]:.6g}]"
                unit = "rad" if sms.layout.turns[i] else "m"
                raise InvalidValue(name, value, f"must start within {within} {unit}")
        check_own_parts((*self.terms, *self.limits), self.motion(np.zeros((2, sms.n))))

    def __repr__(self) -> str:
        place = self.place.text() + (", moving," if self.goal.moves else "")
        summary = f"{self.sms.model.name} to {place} in {self.duration:.4g} s, {self.steps} steps"
        names = [", ".join(part.name for part in parts) or "none" for parts in (self.terms, self.limits)]
        return f"Problem({summary}; terms: {names[0]}; limits: {names[1]})"

    def lasting(self, duration: float) -> Problem:
        """Return the problem with another duration [s], in the same number of steps."""
        duration = positive("duration", duration, "s")
        return replace(self, duration=duration, dt=duration / self.steps)

    @property
    def steps(self) -> int:
        """The number of steps."""
        return round(self.duration / self.dt)

    @property
    def nodes(self) -> FloatArray:
        """The times of a finished motion's nodes (N + 1,) [s]."""
        return np.arange(self.steps + 1, dtype=np.float64) * self.dt

    @property
    def kappa(self) -> float:
        """The sharpness of C~ in the measures of motions: `kappa` of the first term that has it, else 10."""
        return next((term.kappa for term in self.terms if term.kappa is not None), Coupling.kappa)

    @cached_property
    def cost_terms(self) -> tuple[Term, ...]:
        """The terms whose cost decides when a search ends (`Term.measures_cost`)."""
        return tuple(term for term in self.terms if term.measures_cost)

    @cached_property
    def place(self) -> Place:
        """The desired pose of the end effector at the deadline."""
        place: Place = self.goal.place(self.duration)
        return place

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """The mask of joints that can move (n,)."""
        return np.array([name not in self.locked for name in self.sms.joint_names])

    @cached_property
    def stack(self) -> ArmStack:
        """The robot's kinematics and dynamics for stacks of configurations."""
        return self.sms.arm_stack(self.mode)

    @property
    def wheels(self) -> ReactionWheels | None:
        """The wheels that hold the attitude, if any."""
        return self.sms.wheels if self.mode == "rotation-floating" else None

    @property
    def thrusters(self) -> Thrusters | None:
        """The thrusters that hold attitude or position, if any."""
        return self.sms.thrusters if self.mode.endswith("flying") else None

    @cached_property
    def wheel_total(self) -> FloatArray:
        """The momenta (w,) of the wheels that hold the attitude, with the joints at rest [N m s]."""
        if self.wheels is None:
            return np.zeros(0)
        of_arm = wheel_shares(self.wheels) @ held_momentum(self.arm0)[..., 0] @ self.joint_rates
        return np.asarray(self.wheel_momentum + of_arm)

    def motion(self, rates: FloatArray, dt: float | None = None) -> Rollouts:
        """Return the motion, at nodes and midpoints, with joint rates (N + 1, n) at nodes `dt` [s] apart."""
        rates = matrix("rates", rates, None, self.sms.n)
        if len(rates) < 2:
            raise InvalidValue("rates", rates, "must have at least two rows")
        step = self.dt if dt is None else positive("dt", dt, "s")
        motion = rolled_out(self.sms, self.stack, self.q0, rates, step, self.momentum)
        return replace(motion, **given(self, self.goal, motion.times))

    @cached_property
    def joints0(self) -> FloatArray:
        """The joint positions at the start (n,)."""
        return self.sms.layout.positions(self.q0)

    @cached_property
    def arm0(self) -> ArmValues:
        """The kinematics of the arm at the start, as a stack of one configuration."""
        return self.stack.evaluate(self.joints0[:, None])

    @cached_property
    def rotation0(self) -> FloatArray:
        """The base attitude at the start (3, 3)."""
        return np.asarray(pin.Quaternion(self.q0[3:7]).toRotationMatrix())

    @cached_property
    def com0(self) -> FloatArray:
        """The centre of mass at the start (3,) [m], of the system, or of the base if its position is held."""
        return np.asarray(self.q0[:3] + self.rotation0 @ self.arm0.com[:, 0])

    @property
    def centre(self) -> str:
        """The name of the point `com0`, for messages."""
        return f"{'system' if 0 in MODES[self.mode] else 'base'}'s centre of mass"

    @cached_property
    def tip0(self) -> FloatArray:
        """The position of the end effector at the start (3,) [m]."""
        return np.asarray(self.com0 + self.rotation0 @ self.arm0.rho[:, 0])

    @property
    def required_momentum(self) -> FloatArray | None:
        """The total momentum (6,) that the goal requires; None if any momentum is admissible."""
        client = self.goal.at_rest_with
        return None if client is None else rest_momentum(client, self.com0)

    @cached_property
    def drift(self) -> FloatArray:
        """The velocity of the centre of mass `com0` (3,) [m/s]."""
        return np.zeros(3) if self.momentum is None else self.momentum[:3] / self.stack.mass

    @property
    def tumbles(self) -> bool:
        """True if the robot has angular momentum."""
        return self.momentum is not None and bool(self.momentum[3:].any())

    @cached_property
    def at_all_times(self) -> dict[str, Any]:
        """The fields of `Rollouts` that depend on the problem alone."""
        root = pin.XYZQUATToSE3(self.q0[:7] if self.base_start is None else self.base_start)
        return {
            "base_start": root.act(self.stack.base_com),
            "rotation_start": root.rotation.copy(),
            "mean_speed": self.mean_speed,
            "wheels": self.wheels,
            "wheel_total": self.wheel_total,
            "thrusters": self.thrusters,
            "time_offset": self.time_offset,
        }

    @cached_property
    def mean_speed(self) -> float:
        """The mean speed on a straight line of at least 2 cm to the target [m/s], a scale of speeds."""
        place = self.place.at(self.q0)  # a place on the base is evaluated at the start pose of the base
        return max(float(np.linalg.norm(place.position - self.tip0)), 0.02) / self.duration


def given(problem: Problem, goal: Goal, times: FloatArray) -> dict[str, Any]:
    """Return the fields of `Rollouts` that depend on a problem, and on a goal at times (K,) [s]."""
    places = goal.places(times)
    target = np.zeros((3, len(times))) + places.position
    return {**problem.at_all_times, "target": target, "target_on": places.on}


def _with_others(limits: Sequence[Limit], *others: Limit) -> tuple[Limit, ...]:
    """Return the limits, and each of `others` whose name no limit has."""
    return (*limits, *(other for other in others if other.name not in [limit.name for limit in limits]))
