"""Pink's tasks and limits on a free-floating robot, whose base reacts (extra `[pink]`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance, number, positive, vector
from ffsms_pin.extras import require
from ffsms_pin.system import SpaceManipulator, State, base_reaction, dynamics

require("pink", "Pink's tasks")

import pink  # noqa: E402
from pink.tasks import Task  # noqa: E402

__all__ = ["FloatingConfiguration", "MomentumTask"]


class FloatingConfiguration(pink.Configuration):  # type: ignore[misc]
    """Pink's `Configuration` of a free-floating robot.

    Every task and limit of Pink works on it. Its model has the joint limits of `sms.limits`, and none for the
    base. What is integrated are the joint rates; the base moves as the momentum equation says.

    Parameters
    ----------
    sms : SpaceManipulator
    state : State or array_like, shape (nq,)
        A state of ours, `sms.at(q)`, or Pinocchio's q.
    momentum : array_like, shape (6,), optional
        Total momentum [linear; angular], inertial axes, about the system's centre of mass; default zero.
    """

    def __init__(
        self, sms: SpaceManipulator, state: State | ArrayLike, momentum: ArrayLike | None = None
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        q = state.q if isinstance(state, State) else vector("state", state, sms.nq)
        model = sms.model.copy()  # Pink adds attributes to it
        rates, torques = np.array(model.upperVelocityLimit), np.array(model.upperEffortLimit)
        rates[:6], rates[6:], torques[6:] = np.inf, sms.limits.velocity, sms.limits.torque
        model.upperVelocityLimit, model.upperEffortLimit = rates, torques
        model.lowerPositionLimit[:7], model.upperPositionLimit[:7] = -1e20, 1e20  # Pink's "no limit"
        super().__init__(model, model.createData(), np.array(q), copy_data=False)
        self.sms = sms
        self.momentum = None if momentum is None else vector("momentum", momentum, 6)

    @property
    def state(self) -> State:
        """Our state here, at rest."""
        return self.sms.at(self.q)

    def integrate(self, velocity: ArrayLike, dt: float) -> FloatArray:
        """The configuration (nq,) after `dt` [s] of a velocity (6 + n,), whose joint rates are held.

        By the midpoint rule, whose error is of third order in `dt`; the base's entries in `velocity` are not
        used.
        """
        dt = number("dt", dt)
        rates = vector("velocity", velocity, self.sms.nv)[6:]
        first = self.sms.velocity(self.q, rates, self.momentum)
        middle = pin.integrate(self.model, self.q, 0.5 * dt * first)
        over = dt * self.sms.velocity(middle, rates, self.momentum)
        return np.array(pin.integrate(self.model, self.q, over))

    def integrate_inplace(self, velocity: ArrayLike, dt: float) -> None:
        """Go on by `dt` [s], as `integrate` says."""
        self.update(self.integrate(velocity, dt))


class MomentumTask(Task):  # type: ignore[misc]
    """The base reacts as the momentum equation says: for `constraints` of Pink's `solve_ik`.

    With it a Jacobian of Pink's acts like the generalised Jacobian J*: base displacement = C_bm times joint
    displacement, and the share of the momentum. Its rows are the root's velocity (6,) in root axes.

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        The step that `solve_ik` is given [s]; it matters only where there is momentum.
    momentum : array_like, shape (6,), optional
        See `FloatingConfiguration`.
    cost : float
        Where it is used as a task, not as a constraint.
    """

    def __init__(
        self, sms: SpaceManipulator, dt: float, momentum: ArrayLike | None = None, cost: float = 1.0
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        super().__init__(cost=cost)
        self.sms, self.dt = sms, positive("dt", dt, "s")
        self.momentum = None if momentum is None else vector("momentum", momentum, 6)

    def compute_error(self, configuration: Any) -> FloatArray:
        """What the momentum moves the base by in a step, negative (6,) [m; rad]."""
        instance("configuration", configuration, pink.Configuration)
        drift = self.sms.velocity(configuration.q, np.zeros(self.sms.n), self.momentum)[:6]
        return -self.dt * drift

    def compute_jacobian(self, configuration: Any) -> FloatArray:
        """[I, M_b^-1 M_bm] (6, 6 + n): the root's velocity less its reaction to the joints."""
        instance("configuration", configuration, pink.Configuration)
        M = dynamics.inertia_matrix(self.sms, np.array(configuration.q))
        return np.hstack([np.eye(6), -base_reaction.root_reaction(M)])

    def __repr__(self) -> str:
        return f"MomentumTask({self.sms!r})"
