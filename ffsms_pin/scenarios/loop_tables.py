"""Tables of a scenario file about the closed loop: control, what is simulated, and what goes wrong."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from ffsms_pin.control import LAWS
from ffsms_pin.scenarios.keys import *
from ffsms_pin.simulation import INTEGRATORS


class Control(Keys):
    """[control]: the joints' law and its gains."""

    law: Annotated[str, OneOf(tuple(LAWS))] = key("", '"sliding-mode"')
    """"sliding-mode" (the paper's), "computed-torque", "pd", "impedance" or "admittance"; the last two are in
    [impedance](impedance.md)"""
    K_s: Gain = key("N m", "0.001", 'switching gain of "sliding-mode"')
    K_p: Gain = key("1/s² or N m/rad", "the law's")
    """stiffness of "computed-torque" (25), "pd" (0.5), "admittance" (400)"""
    K_d: Gain = key("1/s, N m s/rad", "the law's", "damping of these (10, 0.5, 40)")
    coulomb: PerJointNotNegative = key(
        "N m", "the robot's", 'of "computed-torque": the friction it compensates'
    )
    viscous: PerJointNotNegative = key("N m s/rad", "the robot's", "of it, likewise")
    learn_friction: bool = key("", "true", 'of "computed-torque"; false with [client]')
    Gamma: Gain = key("1/s", "10", "slope of the sliding surface")
    boundary: PerJointPositive = key("rad/s", "0.02", "lambda, half the boundary layer's width; per joint")
    stiffness: PerJointPositive = key("N/m", "200", 'of "impedance", "admittance": one, or one an axis')
    turn_stiffness: PerJointPositive = key("N m/rad", "10", "of these two as well, about the axes")
    damping_ratio: NotNegative = key("", "1", "of these two: of every mode")
    posture_stiffness: Positive = key("N m/rad", "5", "of these: of what leaves the end effector still")
    force_limit: Limit = key("N", "20", "of these: largest force of a contact at rest; may be inf")
    mass: Positive = key("kg", "10", 'of "admittance"')
    inertia: Positive = key("kg m²", "0.2", 'of "admittance", about any axis')
    torque_limit: PerJointLimit = key("N m or N", "[limits] torque", "cut off there; per joint, may be inf")
    dt: Positive = key("s", "0.001", "control and integration step; the torque is held for it")
    offset: PerJoint = angle("rad or m", "0")
    """how far from the plan's start the simulated arm starts; per joint"""


class Reference(Keys):
    """[reference]: what the loop follows."""

    kind: Literal["plan", "re-planning"] = key("", '"plan"')
    """"plan": the plan made once; "re-planning": a step is planned from the measured state, `planner.track`.
    The plan made once is then simulated beside it"""
    dt: Positive = key("s", "[plan] dt", "how often a step is planned in the loop")
    period: Positive = key("s", "0.1")
    """between two plans of the rest of the motion; for "re-planning", see `ReplanOptions`"""
    hold: NotNegative = key("s", "0", "how long to stay at the target after the arrival")
    dead_band: NotNegative = key("m", "from the sensors")
    """within it an arm that has arrived rests ([noise and latency](noise.md)); for "re-planning"."""
    jerk: PerJointPositive = angle("rad/s³ or m/s³", "none")
    """commanded accelerations change no faster, where the limits allow it; per joint, for "re-planning"."""


class Simulation(Keys):
    """[simulation]: how the plant is integrated, and from where."""

    integrator: Annotated[str, OneOf(tuple(INTEGRATORS))] = key("", '"rk4"')
    """"rk4"; "variational" for long runs; "adaptive" to check the others; "stiff" for steep friction"""
    substeps: Annotated[int, Field(ge=1, le=1000)] = key("", "1; with a client 8")
    """integration steps in a control step; with a client, in the steps in which a contact acts"""
    momentum: Vector6 = key("kg m/s, kg m²/s", "[plan] momentum")
    """total momentum at the start (6 numbers), about the centre of mass; given here, the base moves by it as
    a floating one, and else as the plan's `mode` has it"""
    q0: Numbers = key("", "the plan's start")
    """configuration at the start (nq numbers), Pinocchio's: base position, quaternion (x, y, z, w), joints"""
    wheel_momentum: Numbers = key("N m s", "0")
    """spin momentum of each wheel at the start; `momentum` does not count it"""
    v0: Numbers = key("", "at rest, with the momentum")
    """velocity at the start (6 + n numbers), Pinocchio's; in place of the momentum"""


class RandomPlant(Keys):
    """[plant.random]: one plant drawn around what [plant] says."""

    seed: Whole = key("", "", "of the draw: the same seed, the same plant", required=True)
    arm_mass: NotNegative = key("", "0.2")
    """by what share each body's mass, inertia with it, is off at most: what is known of an arm with its
    harness"""
    base_mass: NotNegative = key("", "0.1", "the same for the base: fuel is burnt")
    base_inertia: NotNegative = key("", "0.1", "the same for its inertia")


class Plant(Keys):
    """[plant]: what is simulated, where it is not the model."""

    model: Text = key("", "the model", "another robot with the same joints, as under [robot]")
    end_effector: Text = key("", "the model's", "its frame; needs `model`")
    arm_mass: PerJointPositive = key("", "1", "factor on the masses of the arm's bodies; per joint")
    arm_inertia: PerJointPositive = key("", "arm_mass")
    """factor on their inertias about their centres of mass: another density, if left out; per joint"""
    arm_com: Shifts = key("m", "0", "shift of their centres of mass in joint axes: 3 numbers, or 3 a joint")
    base_mass: Positive = key("", "1", "factor on the mass of the base")
    base_inertia: Positive = key("", "base_mass", "factor on its inertia")
    base_com: Vector3 = key("m", "0", "shift of its centre of mass in the root frame")
    random: RandomPlant = table()


class Friction(Keys):
    """[friction]: of the joints."""

    viscous: PerJointNotNegative = key("N m s/rad", "0", "per joint")
    coulomb: PerJointNotNegative = key("N m", "0", "per joint")
    transition: Positive = angle("rad/s", "0.01")
    """rate at which three quarters of the Coulomb torque are there; smaller is stiffer"""


class ActuatorErrors(Keys):
    """[actuator]: between the law's torque and the joint: delay, cut off, slew."""

    torque_limit: PerJointLimit = key("N m", "inf", "per joint. The law's own limit is under [control]")
    rate_limit: PerJointLimit = key("N m/s", "inf", "largest change of the torque in time; per joint")
    delay: NotNegative = key("s", "0", "from command to torque, in whole control steps")


class SensorErrors(Keys):
    """[sensors]: what controller and re-planning see."""

    joint_resolution: NotNegative = angle("rad", "0", "step of the encoders")
    joint_noise: NotNegative = angle("rad", "0", "noise before that step")
    joint_rate_noise: NotNegative = angle("rad/s", "0", "")
    base_position_noise: NotNegative = key("m", "0", "each axis")
    base_attitude_noise: NotNegative = angle("rad", "0", "each axis")
    base_velocity_noise: NotNegative = key("m/s", "0", "each axis")
    base_rate_noise: NotNegative = angle("rad/s", "0", "each axis")
    base_latency: NotNegative = key("s", "0", "age of the base's pose and velocity, in whole control steps")
    seed: Whole = key("", "0", "of the noise: the same seed, the same noise")


class Wrist(Keys):
    """[wrist]: the force sensor, for laws that go by it."""

    force_noise: NotNegative = key("N", "0", "each axis")
    moment_noise: NotNegative = key("N m", "0", "each axis")
    bias: Vector6 = key("N, N m", "0", "what is shown where nothing acts (6 numbers)")
    latency: NotNegative = key("s", "0", "age of what is shown, in whole control steps")
    seed: Whole = key("", "0", "of the noise: the same seed, the same noise")
    force_limit: Limit = key("N", "inf", "what the wrist bears; the summary has the largest load beside it")
    moment_limit: Limit = key("N m", "inf", "likewise")


class EstimatorTable(Keys):
    """[estimator]: what is made of noisy or late measurements."""

    on: bool = key("", "true", "false: the measurements are shown as they are")
    joint_acceleration: NotNegative = key("rad/s^1.5", "0.005", "of the joints")
    base_acceleration: NotNegative = key("m/s^1.5", "0.0005")
    """of the base, beside what the momentum equation says"""
    base_angular_acceleration: NotNegative = key("rad/s^1.5", "0.0005", "likewise")


class Disturbance(Keys):
    """[[disturbance]]: a force from outside."""

    wrench: Vector6 = key("N, N m", "", "force and moment (6 numbers), inertial axes", required=True)
    on: Literal["base", "end-effector"] = key("", '"base"')
    """"base": at its centre of mass; "end-effector": at its frame"""
    start: Number = key("s", "0", "when it begins")
    end: AnyTime = key("s", "inf", "when it ends")


class CaptureEvent(Keys):
    """[[capture]]: a body that belongs to the end effector from an instant on."""

    time: NotNegative = key("s", "", "when", required=True)
    mass: Positive = key("kg", "", "", required=True)
    inertia: Inertia = key("kg m²", "", required=True)
    """about its centre of mass, end-effector axes: 3 principal moments, or a matrix of 3 by 3"""
    com: Vector3 = key("m", "[0, 0, 0]", "its centre of mass in the end-effector frame")
    twist: Vector6 = key("m/s, rad/s", "the end effector's")
    """its motion before (6 numbers): with the default, nothing is felt at the instant itself"""


class Fault(Keys):
    """[[fault]]: a joint that fails."""

    time: NotNegative = key("s", "", "when", required=True)
    joint: NameOrIndex = key("", "", "its name, or its index from 0", required=True)
    kind: Literal["locked", "limp"] = key("", '"locked"')
    """"locked": it stays where it is; "limp": it has no torque"""
    told: bool = key("", "true", "whether re-planning knows, and plans with what is left")


class GuardsTable(Keys):
    """[guards]: limits of the flight; one that is exceeded stops it, and the joints are braked."""

    on: bool = key("", "true", "false: no guards; only a state that is not finite ends the run")
    position_margin: Margin = angle("rad or m", "0.001")
    """distance of a joint beyond its stop, or joints that can no longer brake before it"""
    rate_margin: Margin = key("", "0.04", "share by which a joint may exceed its rate limit")
    saturation: Margin = key("s", "0.3", "time of a joint at its torque limit, less the time off it")
    joint_error: Margin = angle("rad or m", "1", "largest deviation of a joint from its reference")
    contact_force: Margin = key("N", "[contact.envelope] force", "of the client on the end effector")
    contact_torque: Margin = key("N m", "[contact.envelope] torque", "of the client on the end effector")
    contact_share: Margin = key("", "1")
    """load of the client on wrist and joints, as a share of what they bear"""
    base_rate: Margin = angle("rad/s", "1", "largest angular velocity of the base")
    energy: Margin = key("", "1")
    """kinetic energy of the joint motion above the largest that the reference asked for, as a share of it"""
    failed_steps: Annotated[int, Field(ge=1)] = key("", "10", "planning steps in a row without a solution")
    path: Text = key("", "none")
    """a file in the results folder for the recording, if a guard trips or the state diverges"""


class CampaignTable(Keys):
    """[campaign]: what `ffsms-pin campaign` draws; a single run does not use it."""

    seed: Whole = key("", "1", "of the first run; the others follow")
    draw: dict[str, Any] = key("", "")
    """a table: distributions by key of this file, as `plant.arm_mass = { uniform = [0.8, 1.2] }`"""
