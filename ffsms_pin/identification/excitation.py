"""A cost term that makes a motion informative about unknown inertial parameters.

The information of a motion is M = sum_k Y_k^T W Y_k, where Y_k is the regressor of the momentum at instant k
and W the weight of the measurements. A criterion F(M) of experiment design is not a sum over instants. But
its linearisation about a plan, -trace(G M) with G = -dF/dM, is such a sum. If G = sum_j g_j g_j^T, the
linearisation is the integral of -sum_j |y_j|^2, where y_j = W^1/2 Y g_j is the weighted momentum of bodies
with the parameters g_j. The term is the integral of sum_j |y_j - 2 y_j0|^2, where y_j0 is y_j in the plan. Up
to a constant, this sum of squares is a majorant of the linearisation, with the same gradient at the plan.

References
----------
V. V. Fedorov, "Theory of Optimal Experiments", Academic Press, 1972, for the linearised criterion. D. R.
Hunter and K. Lange, "A tutorial on MM algorithms", The American Statistician 58 (2004), for the majorant.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, instance, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification.exciting import SAMPLES
from ffsms_pin.identification.identifier import Identifier
from ffsms_pin.opt.costs import Term
from ffsms_pin.opt.derivatives import FrameVariable, Variables
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system.regressors import joint_axes

_WORST = 4  # exponent of the variances in the criterion; a large exponent emphasises the largest variances
_SHOWN = 0.9  # largest deviation of an observable parameter, as a share of the prior deviation


class Excitation(Term):
    """The cost term for the excitation of unknown inertial parameters, mostly of the most uncertain ones.

    The term is linearised about a plan. Solve the problem without the term, then with the term about that
    plan, and repeat this two or three times with the newest plan. The goal of the problem is still reached.
    If plan and problem have different durations, instants at the same share of the duration correspond.

    Parameters
    ----------
    identifier : Identifier
        The identifier of the unknown bodies, with prior deviations and sensors. The information of its
        samples is not used.
    plan : Trajectory
        The plan about which the term is linearised; the arm must move.
    weight : float
        The weight of the term [1/s]. The momenta in the term are divided by their root mean square in the
        plan.
    directions : int
        The number of parameter combinations in the term, beginning with the most uncertain observable one.

    Raises
    ------
    InvalidValue
        An argument has the wrong type or is out of range, or the plan has no information on the parameters.
    """

    name = "excitation"

    def __init__(
        self, identifier: Identifier, plan: Trajectory, weight: float = 0.1, directions: int = 3
    ) -> None:
        instance("identifier", identifier, Identifier)
        instance("plan", plan, Trajectory)
        if plan.q.shape[1] != identifier.robot.nq:
            text = f"must be a plan of the identifier's robot, with {identifier.robot.n} joints"
            raise InvalidValue("plan", plan, text)
        self.weight, self.identifier = at_least_zero("weight", weight), identifier
        directions = whole("directions", directions, 1)
        root, Y = identifier.expected_equations(plan.q, plan.v)
        information = identifier.expected_information(plan.q, plan.v) * (SAMPLES * plan.duration / len(Y))
        C = np.linalg.inv(information + np.eye(len(information)))
        variances = np.diag(C)
        shares = np.where(variances < _SHOWN**2, variances ** (_WORST - 1), 0.0)
        if not shares.any():
            expected = "must move the arm enough to excite at least one unknown parameter"
            raise InvalidValue("plan", plan, expected)
        values, vectors = np.linalg.eigh((C * shares) @ C)  # -dF/dM / 4 for F = sum of variances^4
        chosen = vectors[:, -directions:] * np.sqrt(np.maximum(values[-directions:], 0.0))
        y = root @ Y @ chosen
        mean = np.zeros(y.shape[1:]) if identifier.at_rest else y.mean(axis=0)
        size = np.sqrt(np.mean(np.sum((y - mean) ** 2, axis=(1, 2))))
        self._root, self._offset = root / size, (2.0 * y - mean) / size
        self._about, self._times = plan.q[0, :3], plan.t
        free = np.array([body.free for body in identifier.bodies])
        scales = np.array([body.deviation for body in identifier.bodies])
        self._parameters = np.zeros((chosen.shape[1], *free.shape))
        self._parameters[:, free] = chosen.T
        self._parameters *= scales

    def residual(self, m: Variables) -> list[Any]:
        """Return the weighted momentum of each parameter combination, minus twice that of the plan.

        If the total momentum is unknown, the plan's mean is subtracted from both momenta.
        """
        bodies = self._bodies(m)
        times = m.time_offset + np.asarray(m.times)
        times = times * (self._times[-1] / times[-1])  # the plan may have another duration
        residuals = []
        for j, parameters in enumerate(self._parameters):
            linear, angular = (
                sum(parts) for parts in zip(*map(self._momentum, parameters, bodies), strict=True)
            )
            offset = np.array([np.interp(times, self._times, row) for row in self._offset[:, :, j].T])
            y: Any = self._root[:, :3] @ linear + self._root[:, 3:] @ angular
            residuals.append(np.sqrt(self.weight) * (y - offset[:, None]))
        return residuals

    def _bodies(self, m: Variables) -> list[tuple[FrameVariable, Any, Any]]:
        """Return frame, velocity of the frame's origin and angular velocity of each body, inertial axes."""
        sms, stack, angular_velocity, base = self.identifier.robot, m.stack, m.base_angular_velocity, m.base
        joints = [m.frame(name) for name in sms.joint_names]
        axes = [frame.axis(axis) for frame, axis in zip(joints, joint_axes(sms), strict=True)]

        def relative(moves: FloatArray, point: Any) -> tuple[Any, Any]:
            """Return the velocity of a point and the angular velocity, relative to the base."""
            velocity, angular = 0.0 * angular_velocity, 0.0 * angular_velocity
            for i in np.flatnonzero(moves):
                rate = m.rates[i : i + 1]
                if sms.layout.turns[i]:
                    angular = angular + rate * axes[i]
                    velocity = velocity + rate * axes[i].cross(point - joints[i])
                else:
                    velocity = velocity + rate * axes[i]
            return velocity, angular

        origin = m.velocity - angular_velocity.cross(m.tip - base) - relative(stack.moves_tip, m.tip)[0]
        bodies = []
        for body in self.identifier.bodies:
            if body.index:
                frame = joints[body.index - 1]
                velocity, angular = relative(stack.carries[:, body.index - 1], frame)
            else:
                frame = m.frame(str(sms.model.names[1]))
                velocity, angular = 0.0 * angular_velocity, 0.0 * angular_velocity
            bodies.append(
                (frame, origin + angular_velocity.cross(frame - base) + velocity, angular_velocity + angular)
            )
        return bodies

    def _momentum(self, parameters: FloatArray, body: tuple[FrameVariable, Any, Any]) -> tuple[Any, Any]:
        """Return the momentum that a body would have with `parameters` (10,): linear and angular.

        The angular momentum is about the start position of the plan's root.
        """
        frame, velocity, angular_velocity = body
        m, cx, cy, cz, xx, xy, yy, xz, yz, zz = parameters
        moment, inertia = frame.axis([cx, cy, cz]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        linear = m * velocity + angular_velocity.cross(moment)
        pairs = zip(inertia, np.eye(3), strict=True)
        turning = sum(frame.axis(row) * frame.axis(axis).dot(angular_velocity) for row, axis in pairs)
        return linear, moment.cross(velocity) + turning + (frame - self._about).cross(linear)
