"""The base class of joint laws, and the paper's sliding mode, PD and computed torque laws."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.actuation.wheels import friction_torque
from ffsms_pin.checks import FloatArray, frozen, instance, one_each, positive
from ffsms_pin.control.friction_observer import FrictionObserver
from ffsms_pin.control.payload_observer import PayloadObserver
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import Gain, PerJointNotNegative, PerJointPositive, Unit
from ffsms_pin.references import Observer
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics
from ffsms_pin.system.dynamics import floating_motion


class Motion:
    """A measured state `q`, `v` and a desired joint motion, as arrays.

    The errors are q_e = q - q_d [rad or m], wrapped for continuous joints, and qd_e = qd - qd_d.
    """

    def __init__(self, sms: SpaceManipulator, q: Any, v: Any, q_d: Any, qd_d: Any, qdd_d: Any) -> None:
        arrays = (np.asarray(value, dtype=np.float64) for value in (q, v, q_d, qd_d, qdd_d))
        self.q, self.v, self.q_d, self.qd_d, self.qdd_d = arrays
        self.q_e = sms.layout.difference(self.q, self.q_d)
        self.qd_e = self.v[6:] - self.qd_d


class Kept(threading.local):
    """The state of a law during a run, one per thread; each thread begins with the initial values."""

    def __init__(self, values: dict[str, Any]) -> None:
        vars(self).update(values)

    def __reduce__(self) -> tuple[Any, ...]:
        return Kept, (dict(vars(self)),)


class JointLaw(Observer, ABC):
    """A joint torque law for a free-floating arm.

    Parameters
    ----------
    sms : SpaceManipulator
        The model that the law uses.
    torque_limit : array_like, optional
        The largest size of each torque [N m], one number or (n,), infinite for no limit. Default:
        `sms.limits.torque`.

    Attributes
    ----------
    sms : SpaceManipulator
        The model that the law uses.
    torque_limit : ndarray, shape (n,)
        The largest size of each torque [N m].
    """

    compensates_friction: ClassVar[bool] = False  # true if the law compensates the file's friction
    _gains: ClassVar[tuple[str, ...]] = ()  # attributes that `__repr__` shows and that cannot be set again

    def __init__(self, sms: SpaceManipulator, torque_limit: ArrayLike | None = None) -> None:
        self.sms = sms
        limits = sms.limits.torque if torque_limit is None else torque_limit
        limit = one_each("torque_limit", limits, sms.n, "N m", largest=math.inf)
        self._lowest, self._highest, self._limited = -limit, limit, bool(np.isfinite(limit).any())

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._gains and name in vars(self):
            raise AttributeError(
                f"{name} cannot be changed, because it is checked when a law is created: create another law"
            )
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        gains = "".join(f", {name}={gain_text(getattr(self, name))}" for name in self._gains)
        return f"{type(self).__name__}({self.sms.model.name}{gains})"

    @property
    def torque_limit(self) -> FloatArray:
        """The largest size of each torque (n,) [N m]."""
        return self._highest

    @property
    def friction_torque(self) -> FloatArray:
        """The part (n,) of the last torque that compensates friction [N m] in the joints."""
        return np.zeros(self.sms.n)

    def reset(self, dt: float | None = None) -> None:
        """Clear the state of the last run, before a run with control steps of dt [s]."""

    def torque(
        self, q: ArrayLike, v: ArrayLike, q_d: ArrayLike, qd_d: ArrayLike, qdd_d: ArrayLike
    ) -> FloatArray:
        """Return joint torques for one measured state and one desired joint motion.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Measured configuration in Pinocchio's layout.
        v : array_like, shape (6 + n,)
            Measured velocity in Pinocchio's layout.
        q_d, qd_d, qdd_d : array_like, shape (n,)
            Desired joint positions [rad], rates [rad/s] and accelerations [rad/s^2].

        Returns
        -------
        ndarray, shape (n,)
            Joint torques [N m] within `torque_limit`. They may be NaN if the state is not finite or the law
            overflows; `simulate` then raises `SimulationDiverged`.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            tau = self._law(Motion(self.sms, q, v, q_d, qd_d, qdd_d))
        return self._cut_off(tau) if self._limited else tau

    def _cut_off(self, tau: FloatArray) -> FloatArray:
        result: FloatArray = np.minimum(np.maximum(tau, self._lowest), self._highest)
        return result

    @abstractmethod
    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants [s], ascending, of small errors at a configuration q (nq,)."""

    @abstractmethod
    def _law(self, motion: Motion) -> FloatArray:
        """Return the torques (n,) before the limits."""


def gain_matrix(name: str, value: ArrayLike, n: int) -> FloatArray:
    """Return a symmetric positive definite gain matrix (n, n) from one number, a diagonal or a matrix."""
    array = np.array(value, dtype=np.float64)
    if array.shape not in ((), (n,), (n, n)) or not np.isfinite(array).all():
        message = f"must be one finite number, {n} finite numbers, or a finite matrix ({n}, {n})"
        raise InvalidValue(name, value, message)
    gain = array if array.ndim == 2 else np.diag(np.broadcast_to(array, n))
    if np.abs(gain - gain.T).max() > 1e-12 * np.abs(gain).max() or np.linalg.eigvalsh(gain)[0] <= 0.0:
        kind = "above zero" if array.ndim < 2 else "symmetric positive definite"
        raise InvalidValue(name, value, f"must be {kind}")
    return frozen(gain)


def gain_text(gain: ArrayLike) -> str:
    """Return a gain as text: a number if all joints have the same gain, else the diagonal or the shape."""
    values = np.asarray(gain)
    if values.ndim == 2:
        diagonal = np.diag(values)
        if np.any(values != np.diag(diagonal)):
            return f"({len(values)}, {len(values)}) matrix"
        values = diagonal
    if values.ndim == 1 and values.size and not np.all(values == values[0]):
        return "[" + ", ".join(f"{x:g}" for x in values) + "]"
    return f"{values.ravel()[0]:g}"


def time_constants(H: FloatArray, K_d: FloatArray, K_p: FloatArray) -> FloatArray:
    """Return the time constants -1 / Re(pole) (2 n,) [s], ascending, of H x'' + K_d x' + K_p x = 0."""
    A = np.block([[np.zeros_like(H), np.eye(len(H))], [-np.linalg.solve(H, K_p), -np.linalg.solve(H, K_d)]])
    return np.sort(-1.0 / np.linalg.eigvals(A).real)


def reduced_dynamics(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return H_q and C_q of tau = H_q qdd + C_q (paper, "Sliding Mode Control Design").

    The values are those of `State.H_q` and `State.C_q`, computed without a state.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Configuration in Pinocchio's layout.
    v : ndarray, shape (6 + n,)
        Velocity in Pinocchio's layout.

    Returns
    -------
    H_q : ndarray, shape (n, n)
        Reduced inertia matrix: the Schur complement of the base block.
    C_q : ndarray, shape (n,)
        Reduced Coriolis and centrifugal torque [N m].
    """
    M = dynamics.inertia_matrix(sms, q)
    N = floating_motion(M)
    return M[6:] @ N, dynamics.velocity_effects(sms, q, v) @ N


class SlidingModeController(JointLaw):
    """A sliding mode law of the joints; the base reacts freely.

    tau = H_q (qdd_d - Gamma qd_e) + C_q - K_s sat(s / boundary),  s = qd_e + Gamma q_e,

    with q_e = q - q_d and qd_e = qd - qd_d. sat limits every entry to the range -1 to 1 (paper, Eq.
    sliding_surface and control_torque). The torque is then limited to `torque_limit`. H_q and C_q are those
    of the measured q and v.

    With an exact model and torques within their limits, H_q ds/dt = -K_s sat(s / boundary), and on s = 0 the
    error decays as exp(-Gamma t). K_s determines how fast s = 0 is reached:

    - Outside the boundary layer ds/dt = -H_q^-1 K_s sign(s), so the rate does not depend on the size of s.
    - Inside, s decays exponentially, with time constants of about H_q boundary / K_s (`time_constants`).

    The defaults are the paper's gains for its planar system. With these gains the arm follows a plan that
    starts at its configuration, but an initial error of 20 mrad remains for longer than 12 s. Ten times the
    paper's K_s removes this error. In a sampled loop, the shortest time constant should be longer than the
    control step; below half of the control step, the torque chatters.

    Proof (paper, appendix): V = s^T H_q s / 2 has dV/dt = -s^T K_s sat(s / boundary) + s^T (dH_q/dt) s / 2.
    The paper neglects the last term. V therefore decreases for certain only if the first term dominates, as
    with slow joints or a large K_s. The proof by passivity in docs/simulate.md neglects no term.

    Parameters
    ----------
    sms : SpaceManipulator
        The model that the law uses.
    K_s : array_like
        Switching gain [N m]: one number, a vector (n,) for a diagonal, or a matrix (n, n), symmetric positive
        definite. The paper's proof holds for a diagonal matrix; another matrix must be diagonally dominant to
        drive every entry of s towards zero.
    Gamma : array_like
        Slope of the sliding surface [1/s], in the same forms as K_s.
    boundary : array_like
        The paper's lambda, the thickness of the boundary layer in s [rad/s]: one number, or (n,) if K_s is
        diagonal.
    torque_limit : array_like, optional
        See `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, a gain that is not symmetric positive definite, or a boundary or limit out of range.
    """

    _gains = ("K_s", "Gamma", "boundary")

    def __init__(
        self,
        sms: SpaceManipulator,
        K_s: Annotated[Gain, Unit("N m")] = 0.001,
        Gamma: Annotated[Gain, Unit("1/s")] = 10.0,
        boundary: Annotated[PerJointPositive, Unit("rad/s")] = 0.02,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.K_s = gain_matrix("K_s", K_s, sms.n)
        self.Gamma = gain_matrix("Gamma", Gamma, sms.n)
        self.boundary = one_each("boundary", boundary, sms.n, "rad/s")
        if np.ndim(boundary) > 0 and np.any(self.K_s != np.diag(np.diag(self.K_s))):
            raise InvalidValue("boundary", boundary, "must be one number if K_s is not diagonal")

    def _law(self, motion: Motion) -> FloatArray:
        desired = motion.qdd_d - self.Gamma @ motion.qd_e
        torque = dynamics.floating_torque(self.sms, motion.q, motion.v, desired)
        s = motion.qd_e + self.Gamma @ motion.q_e
        return torque - self.K_s @ np.minimum(np.maximum(s / self.boundary, -1.0), 1.0)

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants (n,) [s], ascending, of s inside the boundary layer at q (nq,).

        In the layer H_q ds/dt = -K_s s / boundary, so the time constants are the eigenvalues of boundary
        K_s^-1 H_q. Compare the longest with the duration of the move, and the shortest with the control step.
        """
        from scipy.linalg import eigh  # slow to load

        H_q = self.sms.at(q).H_q
        constants: FloatArray = eigh(H_q, self.K_s / self.boundary, eigvals_only=True)
        return constants


class PD(JointLaw):
    """A proportional-derivative law of the joints, without a model.

    tau = -K_p q_e - K_d qd_e

    Proof, for a constant q_d and zero momentum: V = qd^T H_q qd / 2 + q_e^T K_p q_e / 2 has dV/dt = qd^T tau
    + qd^T K_p q_e = -qd^T K_d qd <= 0, since dH_q/dt - 2 C is skew-symmetric. There is no gravity load in
    orbit, so by LaSalle the joints come to rest at q_d. The joints lag behind a moving q_d.

    Source: M. Takegaki and S. Arimoto, "A new feedback method for dynamic control of manipulators", Journal
    of Dynamic Systems, Measurement, and Control 103 (1981), here for the reduced system.

    Parameters
    ----------
    sms : SpaceManipulator
        The robot, for its joints and torque limits; the law uses no masses.
    K_p : array_like
        Stiffness [N m/rad]: one number, a diagonal (n,), or a symmetric positive definite matrix.
    K_d : array_like
        Damping [N m s/rad], in the same forms as K_p. K_d times the control step should be smaller than the
        smallest eigenvalue of H_q. The default suits the paper's planar system, whose smallest eigenvalue is
        0.002 kg m^2, at a control step of 1 ms.
    torque_limit : array_like, optional
        See `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, or a gain that is not symmetric positive definite.
    """

    _gains = ("K_p", "K_d")

    def __init__(
        self,
        sms: SpaceManipulator,
        K_p: Annotated[Gain, Unit("N m/rad")] = 0.5,
        K_d: Annotated[Gain, Unit("N m s/rad")] = 0.5,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        super().__init__(sms, torque_limit)
        self.K_p = gain_matrix("K_p", K_p, sms.n)
        self.K_d = gain_matrix("K_d", K_d, sms.n)

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants (2 n,) [s], ascending, of a small error: H_q x'' + K_d x' + K_p x = 0."""
        return time_constants(self.sms.at(q).H_q, self.K_d, self.K_p)

    def _law(self, motion: Motion) -> FloatArray:
        return -(self.K_p @ motion.q_e) - self.K_d @ motion.qd_e


class ComputedTorque(JointLaw):
    """A computed torque law of the joints; the base reacts freely.

    tau = H_q (qdd_d - K_d qd_e - K_p q_e) + C_q + viscous qd_d + coulomb tanh(qd_d / 0.01 rad/s)
          + F tanh(u / 0.01 rad/s),  u = qd_d - K_d^-1 K_p q_e

    F is the estimated Coulomb friction in addition to `coulomb` (`FrictionObserver`). Without F, a friction
    of 0.05 N m leaves an error of up to 2 rad at a wrist of 0.001 kg m^2. H_q and C_q include the estimated
    payload (`PayloadObserver`, the law's `robot`). Without this estimate, a wrist with an unknown payload can
    diverge from its reference. Both estimates begin with `reset`, which `simulate` calls before a run; a
    single call of `torque` includes neither. For a robot with thrusters, no payload is estimated.

    After `joint_failed` for a limp joint, the torques of the other joints take into account that the limp
    joint moves passively.

    Proof: with an exact model qdd_e + K_d qd_e + K_p q_e = 0. V = qd_e^T qd_e / 2 + q_e^T K_p q_e / 2 has
    dV/dt = -qd_e^T K_d qd_e <= 0. By LaSalle the error goes to zero, exponentially because the loop is
    linear.

    Source: J. Y. S. Luh, M. W. Walker, R. P. C. Paul, "Resolved-acceleration control of mechanical
    manipulators", IEEE Transactions on Automatic Control 25 (1980), here for the reduced system of a floating
    base, with the kinematics of Y. Umetani and K. Yoshida (1989).

    Parameters
    ----------
    sms : SpaceManipulator
    K_p : array_like
        Stiffness [1/s^2]: one number, a diagonal (n,), or a symmetric positive definite matrix. With the
        defaults the error is critically damped with a time constant of 0.2 s.
    K_d : array_like
        Damping [1/s], in the same forms as K_p.
    torque_limit : array_like, optional
        See `JointLaw`.
    coulomb : array_like, optional
        The expected Coulomb friction of the joints [N m], one number or (n,), see `simulation.JointFriction`.
        Default: that of the robot's file (`sms.joint_friction`). If several joints turn about nearly the same
        axis, their relative motion has almost no inertia, so a small torque that is not modelled causes a
        large error.
    viscous : array_like, optional
        The expected viscous friction of the joints [N m s/rad]. Default: that of the robot's file
        (`sms.joint_damping`).
    adaptive : bool
        True to estimate friction and payload. It must be False if the end effector is in contact, because
        contact forces are not in the law's model. Default: True.

    Raises
    ------
    InvalidValue
        An argument has a wrong shape or is out of range, or a gain is not symmetric positive definite.
    """

    compensates_friction = True
    _gains = ("K_p", "K_d")

    def __init__(
        self,
        sms: SpaceManipulator,
        K_p: Annotated[Gain, Unit("1/s²")] = 25.0,
        K_d: Annotated[Gain, Unit("1/s")] = 10.0,
        torque_limit: ArrayLike | None = None,
        coulomb: Annotated[PerJointNotNegative | None, Unit("N m", "the robot's")] = None,
        viscous: Annotated[PerJointNotNegative | None, Unit("N m s/rad", "the robot's")] = None,
        adaptive: Annotated[bool, Unit("", "true; false with [meet]")] = True,
    ) -> None:
        super().__init__(sms, torque_limit)
        coulomb = sms.joint_friction if coulomb is None else coulomb
        viscous = sms.joint_damping if viscous is None else viscous
        self.K_p = gain_matrix("K_p", K_p, sms.n)
        self.K_d = gain_matrix("K_d", K_d, sms.n)
        self.coulomb = one_each("coulomb", coulomb, sms.n, "N m", least=0.0)
        self.viscous = one_each("viscous", viscous, sms.n, "N m s/rad", least=0.0)
        instance("adaptive", adaptive, bool)
        self.adaptive = adaptive
        self._slope = np.linalg.solve(self.K_d, self.K_p)  # [1/s] the rate at which an error is reduced
        none = np.zeros(sms.n, dtype=bool)
        self._kept = Kept({"observer": None, "payload": None, "friction": np.zeros(sms.n), "limp": none})

    def reset(self, dt: float | None = None) -> None:
        """Clear the state of the last run, before a run with control steps of dt [s].

        If dt is None, friction and payload are not estimated.
        """
        observer = payload = None
        if dt is not None and self.adaptive:
            known = self.viscous, self.coulomb
            observer = FrictionObserver(self.sms, positive("dt", dt, "s"), self.torque_limit, *known)
            if self.sms.thrusters is None:
                payload = PayloadObserver(self.sms, dt, *known)
        none = np.zeros(self.sms.n, dtype=bool)
        kept = {"observer": observer, "payload": payload, "friction": np.zeros(self.sms.n), "limp": none}
        vars(self._kept).update(kept)

    @property
    def robot(self) -> SpaceManipulator:
        """The law's model of the robot: `sms`, with the estimated payload if there is one."""
        payload: PayloadObserver | None = self._kept.payload
        return self.sms if payload is None else payload.robot

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Treat a failed joint (index from 0) as passive until `reset`, unless it is locked."""
        if not locked:
            self._kept.limp = self._kept.limp | (np.arange(self.sms.n) == joint)

    @property
    def friction_torque(self) -> FloatArray:
        """The part (n,) of the last torque that compensates friction [N m] in the joints."""
        friction: FloatArray = self._kept.friction
        return friction

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants (2 n,) [s], ascending, of the error; they are the same for every q."""
        self.sms.checked_configuration("q", q)
        return time_constants(np.eye(self.sms.n), self.K_d, self.K_p)

    def _acceleration(self, motion: Motion) -> FloatArray:
        """Return the joint accelerations (n,) [rad/s^2] at which the error decays."""
        qdd: FloatArray = motion.qdd_d - self.K_d.dot(motion.qd_e) - self.K_p.dot(motion.q_e)
        return qdd

    def _inverse_dynamics(self, motion: Motion) -> FloatArray:
        """Return the torques (n,) for the joint accelerations of `_acceleration`, without friction.

        The accelerations of limp joints result from those of the other joints.
        """
        torque = dynamics.floating_torque(self.robot, motion.q, motion.v, self._acceleration(motion))
        limp: NDArray[np.bool_] = self._kept.limp
        if not limp.any():
            return torque
        M = dynamics.inertia_matrix(self.robot, motion.q)
        H = M[6:] @ floating_motion(M)
        return torque - H[:, limp] @ np.linalg.solve(H[limp][:, limp], torque[limp])

    def _friction(self, motion: Motion) -> FloatArray:
        """Return the torques (n,) that compensate the expected friction at the desired rates."""
        return -friction_torque(motion.qd_d, self.viscous, self.coulomb)

    def _law(self, motion: Motion) -> FloatArray:
        kept, friction = self._kept, self._friction(motion)
        if kept.payload is not None:
            kept.payload.update(motion.q, motion.v)
        if kept.observer is not None:
            kept.observer.update(self.robot, motion.q, motion.v)
            friction = friction + kept.observer.torque(motion.qd_d - self._slope @ motion.q_e)
        kept.friction = friction
        torque = self._inverse_dynamics(motion) + friction
        if kept.observer is not None:
            torque = self._cut_off(torque)
            kept.observer.acted(motion.q, motion.v, torque)
        if kept.payload is not None:
            kept.payload.acted(motion.q, motion.v, torque)
        return torque
