"""Cost terms: the paper's cost, regularisation, and costs of base rotation, wheels and thrusters.

The objective is the sum of the integrals of their squared residuals.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ffsms_pin.actuation.thrusters import ThrusterAllocation
from ffsms_pin.checks import FloatArray, at_least_zero, positive
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.derivatives import Variables, root_of_size
from ffsms_pin.opt.evaluation import Formula, formulas, residuals_of
from ffsms_pin.opt.rollouts import EXACT, Rollouts
from ffsms_pin.options import NotNegative, Positive, Unit

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

# [s] The duration to which the weights of the other terms in this file refer. For other durations time is
# scaled, so that the ratio of the paper's cost to the other terms is independent of the speed of a motion.
REFERENCE_TIME = 8.0


def time_scale(motions: Rollouts | Variables) -> float:
    """Return the duration divided by `REFERENCE_TIME`; powers of this ratio scale residuals."""
    return motions.duration / REFERENCE_TIME


class Term(ABC):
    """A cost term; the integral of its squared residuals is its share of the objective.

    A user's own term is a subclass, passed as `opt.Problem(terms=[...])`; see docs/own-parts.md.

    Attributes
    ----------
    name : str
        The key in `Trajectory.shares`.
    tie_breaker : bool
        True if the term only decides between motions of nearly equal cost in the other terms.
    smooths : bool
        True if the term has a larger weight at the beginning of a search, to avoid poor minima.
    step_weight : float
        The weight of the squared residual in single steps, for redundant motion. It should be small compared
        with 1, the weight of a step's direction. If it is 0, single steps ignore the term.
    measures_cost : bool
        True if the term is part of the cost whose low value ends a search.
    kappa : float or None
        The sharpness of the paper's C~, if the term has one. The measures of a finished motion use it.
    """

    name: str = ""
    tie_breaker: bool = False
    smooths: bool = False
    step_weight: float = 0.0
    measures_cost: bool = False
    kappa: float | None = None

    @abstractmethod
    def residual(self, m: Any) -> Formula:
        """Return the residual, multiplied by the square root of the weight.

        The residual is a variable (S, K) or (c, S, K), or a list of variables, computed from `m`, the
        `opt.Variables` of whole motions or of a single step.
        """

    def step_objective(self, step: StepState) -> tuple[FloatArray, FloatArray] | None:
        """Return W (n, n) and w (n,) that a step adds to its objective as u^T W u / 2 - w^T u.

        u are the joint rates at the step's end. By default the objective favours rates at which the residual
        decays with a time constant of 1 s, or is zero at the step's end if it depends on u alone. If
        `step_weight` is zero, the default is None.
        """
        if self.step_weight == 0.0:
            return None
        variables = step.variables
        W, w = np.zeros((step.sms.n, step.sms.n)), np.zeros(step.sms.n)
        for residual in formulas(self, "residual", variables):
            if residual.where is None:  # variables at selected instants exist for whole motions only
                value, flow, drift, jump = variables.change(residual)
                known = np.isfinite(value)  # in a single step a residual that depends on the goal is NaN
                J, desired = (flow + jump)[known], (jump @ step.rates - value - drift)[known]
                W += self.step_weight * J.T @ J
                w += self.step_weight * J.T @ desired
        return W, w

    def cost(self, m: Variables) -> FloatArray:
        """Return the cost (S,), the integral of the squared residuals."""
        squares = (residual.squares(m.weights, m.count) for residual in residuals_of(self, m))
        return sum(squares, np.zeros(m.count))

    def share(self, motion: Rollouts) -> float:
        """Return the cost of one finished motion, known at nodes and midpoints. Default: `cost`."""
        return float(self.cost(Variables(motion))[0])


@dataclass(frozen=True)
class WeightedTerm(Term):
    """A term with a weight of at least zero."""

    weight: Annotated[NotNegative, Unit()] = 1.0
    """The weight in the objective."""

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)


def soft_assistance(cos_theta: float, kappa: float) -> float:
    """Return C~ = log(1 + exp(kappa cos(theta_a))) / kappa, the paper's smooth max(0, cos(theta_a)).

    The coupling assistance `cos_theta` is in [-1, 1], the sharpness `kappa` above zero.
    """
    x = kappa * cos_theta
    # log(1 + exp(x)) without overflow.
    return (max(x, 0.0) + math.log1p(math.exp(-abs(x)))) / kappa


def step_cost(cos_theta: float, entropy: float, kappa: float) -> float:
    """Return the summand (C~ - (1 - H_norm))^2 of the paper's cost (Eq. optimal_cost)."""
    return (soft_assistance(cos_theta, kappa) - (1.0 - entropy)) ** 2


def ideal_cosine(entropy: float, kappa: float) -> float:
    """Return the cos(theta_a) in [-1, 1] at which a step with the entropy H_norm has the least cost.

    The cost is zero if C~ = 1 - H_norm, at cos(theta_a) = log(exp(kappa (1 - H_norm)) - 1) / kappa.
    Velocities with this cosine form a cone around the direction to the target.
    """
    return kernel.ideal_cosine(entropy, kappa)


@dataclass(frozen=True)
class Coupling(Term):
    """The paper's cost (C~ - (1 - H_norm))^2, integrated over time (Eq. optimal_cost).

    The residual is independent of the end effector's speed, and discontinuous where this speed or the
    distance to the target is zero. In the early stages of a search two factors reduce the residual to zero
    at these points (`rollouts.Smoothing`). The cost of a finished motion has no such factors.

    The paper states no `kappa`; with 10, C~ is close to max(0, cos(theta_a)). The weights of other terms are
    relative to the default `weight` of this term.
    """

    kappa: Annotated[Positive, Unit()] = 10.0
    """The sharpness of the paper's C~."""
    weight: Annotated[Positive, Unit()] = 1.0
    """The weight of the integral in the objective."""
    name = "coupling"
    measures_cost = True

    def __post_init__(self) -> None:
        positive("kappa", self.kappa)
        positive("weight", self.weight)

    def residual(self, m: Variables) -> Any:
        """Return C~ - (1 - H_norm), smoothed by `m.smoothing`."""
        exact: Any = np.logaddexp(0.0, self.kappa * m.cosine) / self.kappa - (1.0 - m.entropy)
        if m.smoothing == EXACT:
            return math.sqrt(self.weight) * exact
        fade_speed, fade_distance = m.smoothing
        near = m.distance / np.hypot(m.distance, fade_distance)
        fade = m.speed / np.hypot(m.speed, fade_speed * m.mean_speed)
        return math.sqrt(self.weight) * near * fade * exact

    def cost(self, m: Variables) -> FloatArray:
        """Return the paper's cost integral (S,) [s] times the weight, without smoothing."""
        soft = np.logaddexp(0.0, self.kappa * m.cosine.value) / self.kappa
        return np.asarray(self.weight * ((soft - (1.0 - m.rollouts.entropy)) ** 2 @ m.rollouts.weights))

    def share(self, motion: Rollouts) -> float:
        """Return the paper's sum over the steps, times the step's length [s] and the weight."""
        return self.weight * _sum_over_steps(motion, motion.paired.cost(self.kappa))


class _Plain(WeightedTerm):
    """A regularisation term; up to its default weight it only decides between motions of equal cost."""

    smooths = True

    @property
    def tie_breaker(self) -> bool:  # type: ignore[override]  # a class attribute in the base class
        """True if the weight is at most the default; a larger weight is traded against the cost."""
        return self.weight <= type(self).weight


@dataclass(frozen=True)
class Effort(_Plain):
    """The cost of joint rates, which keeps joint travel short.

    `weight` [s^2/rad^2] multiplies (duration / 8 s)^2 and the integral of the squared joint rates. With the
    default weight and a duration of 8 s, a joint that turns by 3 rad at a constant rate costs as much as
    1.1e-4 s of the paper's cost integral. `idle` also multiplies the squared rates of joints that do not move
    the end effector, such as the joints of a second arm.
    """

    weight: Annotated[NotNegative, Unit()] = 1e-4
    idle: float = 100.0
    name = "effort"

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least_zero("idle", self.idle)

    def residual(self, m: Variables) -> Any:
        """Return the weighted joint rates."""
        idle = np.where(m.stack.moves_tip == 0.0, np.sqrt(self.idle), 1.0)
        return np.sqrt(self.weight) * time_scale(m) * idle * m.rates


@dataclass(frozen=True)
class Smooth(_Plain):
    """The cost of joint accelerations.

    `weight` [s^4/rad^2] multiplies (duration / 8 s)^4 and the integral of the squared joint accelerations.
    """

    weight: Annotated[NotNegative, Unit()] = 1e-5
    name = "smooth"

    def residual(self, m: Variables) -> Any:
        """Return the weighted joint accelerations."""
        return np.sqrt(self.weight) * time_scale(m) ** 2 * m.accelerations


@dataclass(frozen=True)
class BaseTurn(WeightedTerm):
    """The cost of the base's rotation.

    `weight`, in units of 32 s^2/rad^2, multiplies (duration / 8 s)^2 and the integral of the base's squared
    angular velocity. With the weight 1 and a duration of 8 s, a base rotation by 0.05 rad at a constant rate
    costs as much as 0.01 s of the paper's cost integral.
    """

    name = "base turn"

    def residual(self, m: Variables) -> Any:
        """Return the weighted angular velocity of the base."""
        return np.sqrt(32.0 * self.weight) * time_scale(m) * m.base_angular_velocity


@dataclass(frozen=True)
class WheelMomentum(WeightedTerm):
    """The cost of the momenta of wheels that hold the attitude; zero without wheels.

    `weight` [1/(N m s)^2] multiplies (duration / 8 s)^2 and the integral of the wheels' squared momenta.
    """

    name = "wheel momentum"

    def residual(self, m: Variables) -> Any:
        """Return the weighted momentum of each wheel."""
        return np.sqrt(self.weight) * time_scale(m) * m.wheels


@dataclass(frozen=True)
class _Rounded(WeightedTerm):
    """A term whose absolute values are smoothed below `rounding`."""

    rounding: Annotated[Positive, Unit("W or N")] = 1e-3
    """The power of a wheel, or force of a thruster, below which its absolute value is smoothed."""
    unit = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("rounding", self.rounding, self.unit)


@dataclass(frozen=True)
class WheelEnergy(_Rounded):
    """The cost of the energy of wheels that hold the attitude; zero without wheels.

    The energy is the integral of the sum of |motor torque x wheel speed| (`Trajectory.wheel_energy`), because
    braking wheels do not regenerate energy. `weight` [s/J] multiplies (duration / 8 s)^3 and the energy.
    `rounding` is the power of a wheel below which its absolute value is smoothed [W], and the largest error
    of a wheel's power.
    """

    name, unit = "wheel energy", "W"

    def residual(self, m: Variables) -> Any:
        """Return the weighted square root of each wheel's smoothed absolute power."""
        if m.rollouts.wheels is None:
            return []
        power = root_of_size(_powers(m.weighted()), self.rounding)
        return np.sqrt(self.weight) * time_scale(m) ** 1.5 * power


@dataclass(frozen=True)
class Propellant(_Rounded):
    """The cost of propellant of thrusters that hold attitude or position; zero without thrusters.

    The force and the moment that hold the base (`Variables.wrench`) are allocated to the thrusters by the
    pseudo-inverse, which may give negative forces. For independent opposed pairs of thrusters within their
    force limits the propellant equals `Trajectory.propellant`, except for the smoothing. For other thrusters
    it is an approximation.
    `weight` [s/g] multiplies (duration / 8 s)^2 and the propellant. `rounding` is the force of a thruster
    below which its absolute value is smoothed [N].
    """

    weight: Annotated[NotNegative, Unit()] = 0.1
    name, unit = "propellant", "N"

    def residual(self, m: Variables) -> Any:
        """Return the weighted square root of each thruster's smoothed propellant flow."""
        thrusters = m.rollouts.thrusters
        if thrusters is None:
            return []
        forces: Any = ThrusterAllocation(thrusters, m.stack.base_com).shares @ m.weighted().wrench
        flow = 1e3 * thrusters.flow(np.ones(1))  # [g/s] per newton
        return np.sqrt(self.weight * flow) * time_scale(m) * root_of_size(forces, self.rounding)


def wheel_energy(motion: Rollouts) -> float:
    """Integrate the sum of |motor torque x wheel speed| over one motion [J], by the midpoint rule."""
    if motion.wheels is None:
        return 0.0
    return _sum_over_steps(motion, np.abs(_powers(Variables(motion)).value[:, 0, 1::2]))


def propellant(motion: Rollouts) -> float:
    """Return the propellant [kg] of thrusters that hold the base during one motion.

    Forces are allocated to the thrusters as in the control of the base, and are continuous. Pulses with the
    same mean force use the same propellant.
    """
    thrusters = motion.thrusters
    if thrusters is None:
        return 0.0
    allocation = ThrusterAllocation(thrusters, motion.stack.base_com)
    wrenches = motion.forces[-6:, 0, 1::2].T
    return _sum_over_steps(
        motion, [thrusters.flow(allocation.forces(wrench[:3], wrench[3:])) for wrench in wrenches]
    )


def _powers(m: Variables) -> Any:
    """Return the motor torque times the speed of each wheel (w, S, K) [W]."""
    wheels: Any = m.rollouts.wheels
    return m.wheel_torques * m.wheels / wheels.inertia


def _sum_over_steps(motion: Rollouts, values: Any) -> float:
    """Integrate step values of one motion over time."""
    return float(np.sum(values)) * float(motion.times[2] - motion.times[0])
