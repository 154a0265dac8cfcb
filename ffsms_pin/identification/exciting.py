"""The exciting motions, which minimise the uncertainty of unknown inertial parameters.

A joint's motion is a window function times a sum of harmonics, so it begins and ends at the start position
at rest. The coefficients of the harmonics minimise the expected standard deviations of the parameters, mostly
the largest ones. Each joint's motion is scaled to 95 % of its nearest limit of displacement, rate or
acceleration; displacements are also limited to pi/2 (rad or m). Then the whole motion is scaled down until it
keeps all other limits.

References
----------
J. Swevers, C. Ganseman, D. Bilgin Tükel, J. De Schutter and H. Van Brussel, "Optimal robot excitation and
identification", IEEE Transactions on Robotics and Automation 13 (1997), for motions as Fourier series.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance, positive, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification.identifier import Identifier
from ffsms_pin.opt.goals.goal import Position
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.problem import Problem, default_limits
from ffsms_pin.opt.rollouts import configurations, rolled_out, velocities
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Sensors

_WIDEST = np.pi / 2.0  # [rad or m] largest displacement to either side
_SHARE = 0.95  # used share of the limits of position, rate and acceleration
_SIZES = (1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1)  # scale factors, tried in this order until all limits are kept
_NODES = 80  # number of instants at which a candidate is evaluated
SAMPLES = 100.0  # [1/s] assumed sampling rate of the measurements
_WORST = 8.0  # exponent of the power mean of the deviations; a large exponent emphasises the largest
_TRIED = 3  # number of random candidates that are checked against all limits


def exciting_motion(
    sms: SpaceManipulator,
    q0: ArrayLike,
    duration: float = 10.0,
    *,
    unknown: Sequence[str] = ("base",),
    known: Mapping[str, Any] | None = None,
    sensors: Sensors | None = None,
    spread: float = 1.0,
    dt: float = 0.02,
    momentum: ArrayLike | None = None,
    limits: Sequence[Limit] | None = None,
    locked: Sequence[str] = (),
    harmonics: int = 2,
    starts: int = 48,
    iterations: int = 8,
    seed: int = 0,
) -> Trajectory:
    """Return a joint motion whose measurement gives the most information on the unknown parameters.

    Parameters
    ----------
    sms : SpaceManipulator
        The prior model.
    q0 : array_like, shape (nq,)
        The start configuration; the joints return to it.
    duration : float
        The duration of the motion [s].
    unknown, known, sensors, spread
        Arguments of `Identifier`.
    dt : float
        Step of the motion [s].
    momentum : array_like, shape (6,), optional
        Total momentum [linear; angular] about the system's centre of mass, inertial axes. Default: zero.
    limits : sequence of Limit, optional
        The limits that the motion keeps. Default: those of `Problem`: joints, torques and a clearance.
    locked : sequence of str
        The names of joints that cannot move.
    harmonics : int
        The number of harmonics of 1 / `duration` that are multiplied by the window function.
    starts, iterations : int
        The number of random candidates, and the largest number of descent steps from the best candidate.
    seed : int
        The seed of the candidates.

    Returns
    -------
    Trajectory
        The motion, which keeps all limits.

    Raises
    ------
    InvalidValue
        An argument is out of range, or no motion from q0 keeps the limits.
    """
    instance("sms", sms, SpaceManipulator)
    duration, dt = positive("duration", duration, "s"), positive("dt", dt, "s")
    identifier = Identifier(sms, unknown, sensors=sensors, known=known, spread=spread)
    limits = default_limits() if limits is None else limits
    start = sms.at(q0).end_effector_pose.translation
    problem = Problem(sms, q0, start, duration, dt, limits=limits, momentum=momentum, locked=locked)
    search = _Search(identifier, problem, whole("harmonics", harmonics, 1, 20))
    rng = np.random.default_rng(whole("seed", seed, 0))
    count = whole("starts", starts, 1, 10_000)
    candidates = [(search.weights * rng.normal(size=search.shape)).ravel() for _ in range(count)]
    candidates.sort(key=search.first)
    best = search.descended(candidates[0], whole("iterations", iterations, 0, 1000))
    tried = [plan for c in [best, *candidates[:_TRIED]] if (plan := search.kept(c)) is not None]
    if not tried:
        text = f"is too close to limits: no motion of {duration:g} s from it keeps them"
        raise InvalidValue("q0", q0, f"{text} ({search.note})")
    return min(tried, key=lambda plan: search.misfit(plan.joint_rates, plan.dt))


class _Search:
    """The search for coefficients (2 harmonics, n) of joint motions with small expected deviations."""

    def __init__(self, identifier: Identifier, problem: Problem, harmonics: int) -> None:
        self.identifier, self.problem, self.sms = identifier, problem, problem.sms
        self.shape = (2 * harmonics, self.sms.n)
        orders = np.arange(1, harmonics + 1)
        #: The scale of the drawn coefficients, small for fast harmonics because accelerations are limited.
        self.weights = np.concatenate([1.0 / orders**2, 1.0 / (orders + 1.0) ** 2])[:, None]
        self.note = ""
        self._shown: Any = None
        limits, start = self.sms.limits, problem.joints0
        up, down = limits.upper - start, start - limits.lower
        self._up = np.where(np.isfinite(up), np.minimum(up, _WIDEST), _WIDEST)
        self._down = np.where(np.isfinite(down), np.minimum(down, _WIDEST), _WIDEST)

    def _basis(self, nodes: int) -> tuple[FloatArray, FloatArray]:
        """Return the windowed harmonics and their time derivatives, (2 harmonics, nodes) each."""
        s = np.linspace(0.0, 2.0 * np.pi, nodes)
        window, slope = 0.5 * (1.0 - np.cos(s)), 0.5 * np.sin(s)
        orders = np.arange(self.shape[0] // 2)[:, None]
        waves = np.vstack([np.cos(orders * s), np.sin((orders + 1) * s)])
        slopes = np.vstack([-orders * np.sin(orders * s), (orders + 1) * np.cos((orders + 1) * s)])
        rate = 2.0 * np.pi / self.problem.duration
        return window * waves, rate * (slope * waves + window * slopes)

    def rates(self, coefficients: FloatArray, nodes: int) -> FloatArray:
        """Return joint rates (nodes, n), scaled to 95 % of the nearest limit; zero for locked joints."""
        basis, slope = self._basis(nodes)
        c = coefficients.reshape(self.shape)
        travel, rates = basis.T @ c, slope.T @ c
        limits = self.sms.limits
        step = self.problem.duration / (nodes - 1)
        uses = [
            travel.max(axis=0) / np.maximum(self._up, 1e-9),
            -travel.min(axis=0) / np.maximum(self._down, 1e-9),
            np.abs(rates).max(axis=0) / limits.velocity,
            np.abs(np.diff(rates, axis=0)).max(axis=0) / step / limits.acceleration,
        ]
        rates *= _SHARE / np.maximum(np.max(uses, axis=0), 1e-9)
        rates[:, ~self.problem.free] = 0.0
        rates[0] = rates[-1] = 0.0
        return np.asarray(rates)

    def deviations(self, rates: FloatArray, dt: float) -> FloatArray:
        """Return the deviations (k,) expected after a motion, as shares of the prior deviations."""
        problem = self.problem
        motion = rolled_out(self.sms, problem.stack, problem.q0, rates, dt, problem.momentum)
        q, v = configurations(self.sms, problem.q0, motion), velocities(motion)
        G = self.identifier.expected_information(q, v) * (SAMPLES * problem.duration / len(q))
        return np.sqrt(np.diag(np.linalg.inv(G + np.eye(len(G)))))

    def misfit(self, rates: FloatArray, dt: float) -> float:
        """Return the power mean of the deviations of the observable parameters."""
        left = self.deviations(rates, dt)[self._shown]
        return float(np.mean(left**_WORST) ** (1.0 / _WORST))

    def first(self, coefficients: FloatArray) -> float:
        """Return the sum of the deviations' logarithms, and add observable parameters to the stored mask."""
        left = self.deviations(self.rates(coefficients, _NODES), self._coarse)
        shown = left < 0.9
        self._shown = shown if self._shown is None else self._shown | shown
        return float(np.log(left).sum())

    @property
    def _coarse(self) -> float:
        return self.problem.duration / (_NODES - 1)

    def descended(self, coefficients: FloatArray, iterations: int) -> FloatArray:
        """Return coefficients with smaller deviations, found by L-BFGS-B from `coefficients`."""
        if iterations == 0 or not self._shown.any():
            return coefficients
        from scipy.optimize import minimize  # slow to load

        def value(c: FloatArray) -> float:
            return float(np.log(self.misfit(self.rates(c, _NODES), self._coarse)))

        options = {"maxiter": iterations, "maxfun": iterations * (coefficients.size + 1) * 2}
        return np.asarray(minimize(value, coefficients, method="L-BFGS-B", options=options).x)

    def kept(self, coefficients: FloatArray) -> Trajectory | None:
        """Return the motion with the largest scale of `_SIZES` that keeps all limits, or None."""
        problem = self.problem
        rates = self.rates(coefficients, problem.steps + 1)
        for size in _SIZES:
            motion = problem.motion(size * rates)
            end = Position(motion.end_effector[:, 0, -1], reach=1.0 + 2.0 * problem.stack.length)
            plan = measure(replace(problem, goal=end), size * rates)
            if plan.clear:
                return plan
            self.note = plan.note
        return None
