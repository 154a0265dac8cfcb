"""Impedance and admittance laws: the end effector responds to forces like a mass, a damper and a spring."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.actuation.wheels import friction_torque
from ffsms_pin.checks import FloatArray
from ffsms_pin.control.laws import JointLaw, Kept, Motion, gain_matrix, time_constants
from ffsms_pin.control.tip_spring import MotionPair, Pull, TipSpring, advance, modal_damping, posture
from ffsms_pin.options import Bound, Gain, NotNegative, PerJointPositive, Positive, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics


class _Compliant(JointLaw):
    """The gains and the state that `Impedance` and `Admittance` share."""

    compensates_friction = True
    _gains: ClassVar[tuple[str, ...]] = (
        "stiffness",
        "turn_stiffness",
        "damping_ratio",
        "posture_stiffness",
        "force_limit",
    )

    def __init__(
        self, sms: SpaceManipulator, torque_limit: ArrayLike | None, damping_ratio: float, *gains: Any
    ) -> None:
        super().__init__(sms, torque_limit)
        self.spring = spring = TipSpring(*gains)
        self.stiffness, self.turn_stiffness = spring.stiffness, spring.turn_stiffness
        self.posture_stiffness, self.force_limit = spring.posture_stiffness, spring.force_limit
        self.damping_ratio = checks.at_least_zero("damping_ratio", damping_ratio)
        self._kept = Kept({"motions": None, "friction": np.zeros(sms.n)})

    @property
    def friction_torque(self) -> FloatArray:
        """The part (n,) of the last torque that compensates the friction of the robot's file [N m]."""
        friction: FloatArray = self._kept.friction
        return friction

    def _with_friction(self, torque: FloatArray, rates: FloatArray) -> FloatArray:
        """Return a torque (n,) plus the compensation of the friction at desired rates (n,)."""
        self._kept.friction = -friction_torque(rates, self.sms.joint_damping, self.sms.joint_friction)
        total: FloatArray = torque + self._kept.friction
        return total


class Impedance(_Compliant):
    """An impedance law: the end effector is compliant about its pose at the desired joints; the base is free.

    tau = J_star^T f - k q_n - D qd_e + H_q qdd_d + C qd_d + friction(qd_d)

    f is the wrench of a spring between the end effector's pose and its pose at the desired joints, both
    rolled out from the same base (see docs/contact.md). q_n is the displacement of the joints from the
    desired joints in the end effector's nullspace, and k the stiffness of a joint spring in this nullspace. D
    gives all modes of arm and springs the same damping ratio. The arm keeps its natural inertia, so no force
    sensor is needed. The friction of the joints is that of the robot's file.

    Proof, for desired joints at rest: let T be the kinetic energy of the whole system, U the energy of the
    springs, and P the power of all external forces. V = T + U has dV/dt = P - qd^T D qd, for any momentum and
    any masses of the plant. The proof requires true joint angles and rates, the robot's true lengths, and
    torques below their limits. So the arm is stable in contact with any passive environment, such as a wall
    or a client. Without momentum and disturbances T = qd^T H_q qd / 2, and a small error decays to zero. A
    constant force F displaces the end effector by F / stiffness from its place in a rigid system that drifts
    under F. With an exact model and without momentum, the arm follows a moving q_d without error.

    Sources: N. Hogan, "Impedance control: an approach to manipulation", Journal of Dynamic Systems,
    Measurement, and Control 107 (1985); C. Ott, "Cartesian impedance control of redundant and flexible-joint
    robots" (2008); J_star: Y. Umetani and K. Yoshida (1989).

    The law has a state, because it integrates both motions. Call `reset` before another run (`simulate`
    does), and `torque` once per control step. Each thread has a state of its own.

    Parameters
    ----------
    sms : SpaceManipulator
    stiffness : array_like
        Stiffness of the spring [N/m]: one number, or three along the axes of the desired end effector. The
        default gives 2 N at a position error of 10 mm. The fastest mode is then up to about 50 rad/s for the
        paper's planar arm, but may exceed 100 rad/s for an arm with a light wrist (see `time_constants`).
    turn_stiffness : array_like
        Rotational stiffness of the spring [N m/rad]: one number, or three about the axes of the desired end
        effector. The default gives 1 N m at 6 deg.
    damping_ratio : float
        Damping ratio of every mode; 1 is critical.
    posture_stiffness : float
        Stiffness k [N m/rad] of the joints in the end effector's nullspace.
    force_limit : float
        Largest force of the spring [N], and so of a contact at rest; may be infinite. The spring reaches the
        default at 0.1 m; this force accelerates a client of 1,000 kg by 2 cm/s^2.
    pose : pinocchio.SE3, optional
        A fixed set point of the end effector, inertial axes, in place of the pose of the desired joints. The
        law is then passive only with the true masses and without momentum, because the set point does not
        drift with the system.
    torque_limit : array_like, optional
        See `JointLaw`.

    Raises
    ------
    InvalidValue
        An argument has a wrong shape or is out of range.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        stiffness: Annotated[PerJointPositive, Unit("N/m")] = 200.0,
        turn_stiffness: Annotated[PerJointPositive, Unit("N m/rad")] = 10.0,
        damping_ratio: Annotated[NotNegative, Unit()] = 1.0,
        posture_stiffness: Annotated[Positive, Unit("N m/rad")] = 5.0,
        force_limit: Annotated[Bound, Unit("N")] = 20.0,
        pose: Any = None,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        gains = damping_ratio, stiffness, turn_stiffness, posture_stiffness, force_limit
        super().__init__(sms, torque_limit, *gains)
        self._pose = None if pose is None else checks.pose("pose", pose)

    def reset(self, dt: float | None = None) -> None:
        """Clear the state of the last run."""
        vars(self._kept).update(motions=None, friction=np.zeros(self.sms.n))

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants (2 n,) [s], ascending, of a small error: H_q x'' + D x' + K x = 0."""
        now = _at_rest(self.sms, q)
        H, K = now.first.H_q, self.spring.pull(self.sms, now).stiffness
        return time_constants(H, modal_damping(H, K, self.damping_ratio), K)

    def _law(self, motion: Motion) -> FloatArray:
        if _lost(motion):
            return np.full(self.sms.n, np.nan)
        now = advance(self.sms, motion.q, motion.q_d, self._kept.motions)
        set_point = None if self._pose is None else pin.XYZQUATToSE3(motion.q[:7]).inverse() * self._pose
        pull = self.spring.pull(self.sms, now, set_point)
        self._kept.motions = now._replace(nullspace=pull.nullspace)
        H_q = now.first.H_q
        D = modal_damping(H_q, pull.stiffness, self.damping_ratio)
        C = dynamics.reduced_coriolis_matrix(self.sms, now.first.q, now.first.N, motion.v[6:])
        torque = pull.torque - D @ motion.qd_e + H_q @ motion.qdd_d + C @ motion.qd_d
        return self._with_friction(torque, motion.qd_d)


class Admittance(_Compliant):
    """An admittance law: the end effector responds to the wrist's wrench like a mass, spring and damper.

    M x'' + D x' = J_star^T (f + F) - k q_n,   M = J_star^T diag(mass, inertia) J_star + H_q / 10,
    tau = H_q (qdd_c - K_d (qd - qd_c) - K_p (q - q_c)) + C_q - J_star^T F_s + friction(qd_c),
    q_c = q_d + x.

    F is the wrench measured at the wrist, and F_s is F after a low pass with the time constant of the inner
    law. f, k and q_n are those of `Impedance`, between the commanded joints q_c and the desired joints q_d. D
    gives all modes the same damping ratio. The joint displacement x is integrated. A tenth of the arm's own
    inertia keeps M invertible where J_star is singular. The inner law is computed torque, which tracks the
    commanded joints; F_s compensates the load at rest.

    The virtual mass is passive for the measured F. The closed loop is not passive, because F is delayed and
    the inner law is stiff. In contact with a wall of stiffness k_w [N/m], a delay T of F reduces the damping
    by k_w T, which must stay below 2 damping_ratio (stiffness mass)^(1/2). Unlike `Impedance`, this law has
    an inner law that reduces the effect of unknown joint friction. A bias of the wrist sensor displaces the
    end effector by bias / stiffness, so subtract the bias before the contact.

    Sources: N. Hogan (1985), as for `Impedance`; Y. Nakamura and H. Hanafusa, "Inverse kinematic solutions
    with singularity robustness for robot manipulator control", Journal of Dynamic Systems, Measurement, and
    Control 108 (1986).

    The law has a state like `Impedance`, and requires a wrist sensor: `Conditions(wrist=WristSensor())`.

    Parameters
    ----------
    sms : SpaceManipulator
    stiffness, turn_stiffness, damping_ratio, posture_stiffness, force_limit
        See `Impedance`.
    mass : float
        Virtual mass [kg]. The default gives 4.5 rad/s with the default stiffness, slow compared with the
        inner law.
    inertia : float
        Virtual inertia about any axis [kg m^2]. The default gives 7 rad/s with the default stiffness.
    K_p : array_like
        Stiffness of the inner law [1/s^2], as for `ComputedTorque`. With the defaults, the inner law is
        critically damped with a time constant of 0.05 s, stiff compared with the spring.
    K_d : array_like
        Damping of the inner law [1/s].
    torque_limit : array_like, optional
        See `JointLaw`.

    Raises
    ------
    InvalidValue
        An argument has a wrong shape or is out of range.
    """

    _gains = (*_Compliant._gains, "mass", "inertia", "K_p", "K_d")
    needs_wrist = True

    def __init__(
        self,
        sms: SpaceManipulator,
        stiffness: Annotated[PerJointPositive, Unit("N/m")] = 200.0,
        turn_stiffness: Annotated[PerJointPositive, Unit("N m/rad")] = 10.0,
        damping_ratio: Annotated[NotNegative, Unit()] = 1.0,
        posture_stiffness: Annotated[Positive, Unit("N m/rad")] = 5.0,
        force_limit: Annotated[Bound, Unit("N")] = 20.0,
        mass: Annotated[Positive, Unit("kg")] = 10.0,
        inertia: Annotated[Positive, Unit("kg m²")] = 0.2,
        K_p: Annotated[Gain, Unit("1/s²")] = 400.0,
        K_d: Annotated[Gain, Unit("1/s")] = 40.0,
        torque_limit: ArrayLike | None = None,
    ) -> None:
        gains = damping_ratio, stiffness, turn_stiffness, posture_stiffness, force_limit
        super().__init__(sms, torque_limit, *gains)
        self.mass = checks.positive("mass", mass, "kg")
        self.inertia = checks.positive("inertia", inertia, "kg m^2")
        self.K_p, self.K_d = gain_matrix("K_p", K_p, sms.n), gain_matrix("K_d", K_d, sms.n)
        self._kept = Kept(self._start(1e-3))

    def _start(self, dt: float) -> dict[str, Any]:
        """Return the state of the law at the start of a run with control steps of dt [s]."""
        still, nothing = np.zeros(self.sms.n), np.zeros(6)
        wrenches = {"wrench": nothing, "smooth": nothing}
        return {
            "motions": None,
            "friction": still,
            "displacement": still,
            "rate": still,
            "dt": dt,
            **wrenches,
        }

    def reset(self, dt: float | None = None) -> None:
        """Clear the state of the last run, before a run with control steps of dt [s]; None keeps dt."""
        dt = self._kept.dt if dt is None else checks.positive("dt", dt, "s")
        vars(self._kept).update(self._start(dt))

    def observe_wrench(self, t: float, wrench: FloatArray) -> None:
        """Store and filter the wrench (6,) on the end effector at t [s], in end-effector axes [N; N m]."""
        kept = self._kept
        lag = 0.5 * np.trace(self.K_d) / np.trace(self.K_p)  # [s] time constant of the inner law
        kept.smooth = kept.smooth + kept.dt / (kept.dt + lag) * (wrench - kept.smooth)
        kept.wrench = wrench

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants (4 n,) [s], ascending, of x and of the inner law's error at rest."""
        now = _at_rest(self.sms, q)
        pull = self.spring.pull(self.sms, now)
        M, eye = self._inertia(now, pull), np.eye(self.sms.n)
        compliance = time_constants(M, modal_damping(M, pull.stiffness, self.damping_ratio), pull.stiffness)
        return np.sort(np.concatenate([compliance, time_constants(eye, self.K_d, self.K_p)]))

    def _inertia(self, now: MotionPair, pull: Pull) -> FloatArray:
        """Return the virtual inertia M (n, n) of the joints."""
        J = pull.J_star
        M: FloatArray = self.mass * J[:3].T @ J[:3] + self.inertia * J[3:].T @ J[3:] + 0.1 * now.first.H_q
        return M

    def _law(self, motion: Motion) -> FloatArray:
        if _lost(motion):
            return np.full(self.sms.n, np.nan)
        sms, kept = self.sms, self._kept
        commanded = motion.q.copy()
        sms.layout.set_positions(commanded, motion.q_d + kept.displacement)
        now = advance(sms, commanded, motion.q_d, kept.motions)
        pull = self.spring.pull(sms, now)
        M, J = self._inertia(now, pull), pull.J_star
        D = modal_damping(M, pull.stiffness, self.damping_ratio)
        load, compensated = (
            (pull.axes @ F[:3]) @ J[:3] + (pull.axes @ F[3:]) @ J[3:] for F in (kept.wrench, kept.smooth)
        )
        acceleration = np.linalg.solve(M, pull.torque + load - D @ kept.rate)
        qdd = motion.qdd_d + acceleration - self.K_d @ (motion.qd_e - kept.rate)
        qdd -= self.K_p @ (motion.q_e - kept.displacement)
        kept.motions, kept.rate = now._replace(nullspace=pull.nullspace), kept.rate + kept.dt * acceleration
        kept.displacement = kept.displacement + kept.dt * kept.rate
        torque = dynamics.floating_torque(sms, motion.q, motion.v, qdd) - compensated
        return self._with_friction(torque, motion.qd_d + kept.rate)


def _lost(motion: Motion) -> bool:
    """Return whether an error is not finite, or at least 1e9 rad or rad/s."""
    return not np.abs([motion.q_e, motion.qd_e]).max() < checks.LARGEST


def _at_rest(sms: SpaceManipulator, q: ArrayLike) -> MotionPair:
    """Return a pair of motions with the same configuration q (nq,)."""
    here = posture(sms, sms.checked_configuration("q", q))
    return MotionPair(here, here, np.eye(3), np.zeros(sms.n))
