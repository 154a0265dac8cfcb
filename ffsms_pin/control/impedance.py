"""Impedance and admittance laws: the end effector responds to forces as a mass, damper and spring would."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.actuation.wheels import friction_torque
from ffsms_pin.checks import FloatArray
from ffsms_pin.control.laws import JointLaw, Kept, Motion, gain_matrix, time_constants
from ffsms_pin.control.tip_spring import Apart, Pull, TipSpring, apart, modal_damping, posture
from ffsms_pin.options import Bound, Gain, NotNegative, PerJointPositive, Positive, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics


class _Compliant(JointLaw):
    """The common gains and state of both laws."""

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
        """Return a torque (n,) plus that which compensates the file's friction at desired rates (n,)."""
        self._kept.friction = -friction_torque(rates, self.sms.joint_damping, self.sms.joint_friction)
        total: FloatArray = torque + self._kept.friction
        return total


class Impedance(_Compliant):
    """An impedance law: a compliant end effector about the pose of the desired joints; the base is free.

    tau = J_star^T f - k wound - D qd_e + H_q qdd_d + C qd_d + friction(qd_d)

    f is the wrench of a spring between the end effector's pose and that of the desired joints, both rolled
    out from the same base (see docs/contact.md). In the end effector's nullspace, wound is the displacement
    of the joints from the desired ones, and k its stiffness. D gives every mode of the arm with its springs
    one damping ratio. The arm keeps its natural inertia, so no force sensor is needed. The friction of the
    joints is that of the robot's file.

    Proof, for desired joints at rest: V = T + U, the whole system's kinetic energy and that of the springs,
    has dV/dt = P - qd^T D qd, where P is the power of all external forces. That holds with any momentum, and
    for a plant of any masses; it needs true joint angles and rates, the robot's true lengths, and torques
    below their limits. So the arm is stable in contact with any passive environment, such as a wall or a
    client. Without momentum and disturbances T = qd^T H_q qd / 2, and the joints come to rest at q_d. A
    constant force F moves the end effector by F / stiffness, away from where a rigid system would have
    drifted with it. An exact model without momentum follows a moving q_d without error.

    Sources: N. Hogan, "Impedance control: an approach to manipulation", Journal of Dynamic Systems,
    Measurement, and Control 107 (1985); C. Ott, "Cartesian impedance control of redundant and flexible-joint
    robots" (2008); J_star: Y. Umetani and K. Yoshida (1989).

    The law is stateful, because it integrates the two motions: call `reset` before another run (`simulate`
    does), and `torque` once per control step. Each thread has a state of its own.

    Parameters
    ----------
    sms : SpaceManipulator
    stiffness : array_like
        Stiffness of the spring [N/m]: one number, or three along the axes of the desired end effector. The
        default gives 2 N at a position error of 10 mm. Its fastest mode is 39 rad/s for an arm of 18 kg and
        45 rad/s for the paper's planar one: a control step of up to 10 ms is short enough.
    turn_stiffness : array_like
        Stiffness about these axes [N m/rad]. The default gives 1 N m at 6 deg.
    damping_ratio : float
        Damping ratio of every mode; 1 is critical.
    posture_stiffness : float
        Stiffness k [N m/rad] of the joints in the end effector's nullspace.
    force_limit : float
        Largest force of the spring [N], and so of a contact at rest; may be infinite. The default is reached
        at 0.1 m, and accelerates a client of 1,000 kg by 2 cm/s^2.
    pose : pinocchio.SE3, optional
        A fixed set point of the end effector, inertial axes, in place of that of the desired joints. The law
        is then passive only with the true masses and without momentum, because a drifting arm is pulled
        towards a set point that does not drift.
    torque_limit : array_like, optional
        See `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, or a number that is not above zero.
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
        """Clear the integrated motions."""
        vars(self._kept).update(motions=None, friction=np.zeros(self.sms.n))

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants (2 n,) [s], ascending, of a small error: H_q x'' + D x' + K x = 0."""
        now = _at_rest(self.sms, q)
        H, K = now.first.H_q, self.spring.pull(self.sms, now).stiffness
        return time_constants(H, modal_damping(H, K, self.damping_ratio), K)

    def _law(self, motion: Motion) -> FloatArray:
        if _lost(motion):
            return np.full(self.sms.n, np.nan)
        now = apart(self.sms, motion.q, motion.q_d, self._kept.motions)
        wanted = None if self._pose is None else pin.XYZQUATToSE3(motion.q[:7]).inverse() * self._pose
        pull = self.spring.pull(self.sms, now, wanted)
        self._kept.motions = now._replace(wound=pull.wound)
        H_q = now.first.H_q
        D = modal_damping(H_q, pull.stiffness, self.damping_ratio)
        C = dynamics.reduced_coriolis_matrix(self.sms, now.first.q, now.first.N, motion.v[6:])
        torque = pull.torque - D @ motion.qd_e + H_q @ motion.qdd_d + C @ motion.qd_d
        return self._with_friction(torque, motion.qd_d)


class Admittance(_Compliant):
    """An admittance law: the end effector responds to the wrist's wrench as a mass, spring and damper.

    M way'' + D way' = J_star^T (f + F) - k wound,   M = J_star^T diag(mass, inertia) J_star + H_q / 10,
    tau = H_q (qdd_c - K_d (qd - qd_c) - K_p (q - q_c)) + C_q - J_star^T F_s + friction(qd_c),
    q_c = q_d + way.

    F is the measured wrench, F_s the same through a low pass as slow as the inner law; f and k are the
    springs of `Impedance`, between the commanded and the desired joints. D gives every mode one damping
    ratio. The displacement `way` of the joints is integrated in joint space: a tenth of the arm's own inertia
    keeps M invertible where J_star is singular, as damping does in its inverse. Computed torque tracks the
    commanded joints; F_s compensates the load at rest.

    The virtual mass is passive for the measured F. The closed loop is not, because F is delayed and the inner
    law is stiff. A wall of k_w [N/m] measured with a delay `late` reduces the damping by k_w late: keep that
    below 2 damping_ratio (stiffness mass)^(1/2). Joint friction is compensated, which is not so with
    `Impedance`. A bias of the wrist sensor moves the end effector by bias / stiffness: subtract it before the
    contact.

    Sources: N. Hogan (1985), as for `Impedance`; Y. Nakamura and H. Hanafusa, "Inverse kinematic solutions
    with singularity robustness for robot manipulator control", Journal of Dynamic Systems, Measurement, and
    Control 108 (1986).

    The law is stateful like `Impedance`, and needs a wrist sensor: `Conditions(wrist=WristSensor())`.

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
        Stiffness of the inner law [1/s^2], as for `ComputedTorque`. The defaults are critically damped with
        0.05 s, stiff compared with the spring.
    K_d : array_like
        Damping of the inner law [1/s].
    torque_limit : array_like, optional
        See `JointLaw`.

    Raises
    ------
    InvalidValue
        A wrong shape, or a number that is not above zero.
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
        """Return the initial state of the law for a control step of dt [s].

        The state has the commanded and the desired motion, the joints' displacement from the desired to the
        commanded motion and its rate (n,), and the last and the filtered wrench at the wrist (6,).
        """
        still, nothing = np.zeros(self.sms.n), np.zeros(6)
        felt = {"wrench": nothing, "smooth": nothing}
        return {"motions": None, "friction": still, "way": still, "rate": still, "dt": dt, **felt}

    def reset(self, dt: float | None = None) -> None:
        """Clear the motions and the wrench; `dt` is the control step of the next run [s]."""
        dt = self._kept.dt if dt is None else checks.positive("dt", dt, "s")
        vars(self._kept).update(self._start(dt))

    def observe_wrench(self, t: float, wrench: FloatArray) -> None:
        """Store the measured wrench at t [s] on the end effector (6,), in its axes [N; N m]."""
        kept = self._kept
        late = 0.5 * np.trace(self.K_d) / np.trace(self.K_p)  # the time constant of critically damped gains
        kept.smooth = kept.smooth + kept.dt / (kept.dt + late) * (wrench - kept.smooth)
        kept.wrench = wrench

    def time_constants(self, q: ArrayLike) -> FloatArray:
        """Return the time constants [s], ascending (4 n,), of displacement and joint error at rest."""
        now = _at_rest(self.sms, q)
        pull = self.spring.pull(self.sms, now)
        M, eye = self._inertia(now, pull), np.eye(self.sms.n)
        compliance = time_constants(M, modal_damping(M, pull.stiffness, self.damping_ratio), pull.stiffness)
        return np.sort(np.concatenate([compliance, time_constants(eye, self.K_d, self.K_p)]))

    def _inertia(self, now: Apart, pull: Pull) -> FloatArray:
        """Return the virtual inertia M (n, n) of the joints."""
        J = pull.J_star
        M: FloatArray = self.mass * J[:3].T @ J[:3] + self.inertia * J[3:].T @ J[3:] + 0.1 * now.first.H_q
        return M

    def _law(self, motion: Motion) -> FloatArray:
        if _lost(motion):
            return np.full(self.sms.n, np.nan)
        sms, kept = self.sms, self._kept
        commanded = motion.q.copy()
        sms.layout.set_positions(commanded, motion.q_d + kept.way)
        now = apart(sms, commanded, motion.q_d, kept.motions)
        pull = self.spring.pull(sms, now)
        M, J = self._inertia(now, pull), pull.J_star
        D = modal_damping(M, pull.stiffness, self.damping_ratio)
        felt, borne = (
            (pull.axes @ F[:3]) @ J[:3] + (pull.axes @ F[3:]) @ J[3:] for F in (kept.wrench, kept.smooth)
        )
        acceleration = np.linalg.solve(M, pull.torque + felt - D @ kept.rate)
        wanted = motion.qdd_d + acceleration - self.K_d @ (motion.qd_e - kept.rate)
        wanted -= self.K_p @ (motion.q_e - kept.way)
        kept.motions, kept.rate = now._replace(wound=pull.wound), kept.rate + kept.dt * acceleration
        kept.way = kept.way + kept.dt * kept.rate
        torque = dynamics.floating_torque(sms, motion.q, motion.v, wanted) - borne
        return self._with_friction(torque, motion.qd_d + kept.rate)


def _lost(motion: Motion) -> bool:
    """Return whether the errors are not finite, or too large to compute with."""
    return not max(np.abs(motion.q_e).max(), np.abs(motion.qd_e).max()) < checks.LARGEST


def _at_rest(sms: SpaceManipulator, q: ArrayLike) -> Apart:
    """Return two motions that are in the same configuration q (nq,)."""
    here = posture(sms, sms.checked_configuration("q", q))
    return Apart(here, here, np.eye(3), np.zeros(sms.n))
