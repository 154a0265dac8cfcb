"""Tables of a scenario file: those of the library's options, and those of the file alone."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from ffsms_pin import opt, simulation
from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.capture.camera import Camera
from ffsms_pin.capture.go_no_go import GoLimits
from ffsms_pin.capture.mass_uncertainty import MassUncertainty
from ffsms_pin.capture.options import Belief, Grip, Nozzle, Replan, Ring
from ffsms_pin.capture.prediction import Envelope
from ffsms_pin.capture.procedure import Procedure
from ffsms_pin.control import LAWS, MomentumDump
from ffsms_pin.options import *
from ffsms_pin.robot import SatelliteBase
from ffsms_pin.scenarios.keys import *
from ffsms_pin.scenarios.parts import HELD_BY, LimitTable, TermTable
from ffsms_pin.scenarios.paths import CURVES

_Mount: Any = table_of(
    SatelliteBase,
    position=(
        Vector3,
        key("m", "centre of the +x face", "where the arm's root link is in the base frame, the box's centre"),
    ),
    rpy=(
        Vector3,
        angle(
            "rad",
            "[0, 1.5708, 0]",
            "its roll, pitch and yaw there. Default: the arm's z axis along the base's x",
        ),
    ),
)
_Dump: Any = table_of(MomentumDump)
_BaseLimits: Any = table_of(opt.BaseLimits)
_Sensor: Any = table_of(Camera)
_Belief: Any = table_of(Belief)


class RobotTable(Keys):
    """The table [robot]: the robot, by name or file."""

    model: Text = key("", "", required=True)
    """a robot that `ffsms_pin.load` knows, as `planar_3r` or `satellite_panda`, or a URDF's path from the
    file's folder"""
    end_effector: Text = key("", "the last link's frame")
    """a frame of it; needed where the arm has several last links"""
    base_size: Sizes3 = key("m", "the URDF's box", "length, width and height of the base")
    wheels: Texts = key("", "none")
    """names of joints of the URDF that are reaction wheels: no joints of the arm"""
    locked: ByJoint = angle("rad or m", "none")
    """joints that become fixed, and where, by name: `{joint_2 = 0.5}`. They are then no joints of the robot;
    those under [plan] stay joints. `locked_deg` is for joints that turn"""
    velocity: PerJointPositive = angle("rad/s or m/s", "the file's")
    """rate limits in place of the file's, which may then be missing or zero; per joint"""
    acceleration: PerJointPositive = angle("rad/s² or m/s²", "1.25 /s times the rate limits")
    """acceleration limits; per joint"""
    torque: PerJointPositive = key("N m or N", "the file's")
    """torque limits in place of the file's, which may then be zero; per joint"""
    inertias: Literal["check", "keep", "repair"] = key("", '"check"')
    """what happens to a link's inertia that no rigid body has: "check": an error; "keep": used as published,
    with a warning; "repair": the nearest one of a rigid body, with a warning"""
    package_dirs: Texts = key("", "none")
    """folders, from the file's, in which `package://` names of meshes are looked for, too"""
    mount: _Mount = table()


class StartTable(Keys):
    """The table [start]: the base is unturned, the system's centre of mass at the inertial origin."""

    joints: Numbers = angle("rad or m", "", "where the joints start, one each", required=True)
    joint_rates: PerJoint = angle("rad/s or m/s", "0")
    """how fast they move at the start, in the plan and in the closed loop; per joint"""


class LimitsTable(Keys):
    """The table [limits]: joint limits in place of the URDF's."""

    lower: PerJoint = angle("rad or m", "the URDF's", "position limit, per joint")
    upper: PerJoint = angle("rad or m", "the URDF's", "position limit, per joint")
    velocity: PerJointPositive = angle("rad/s or m/s", "the URDF's", "rate limit, per joint")
    acceleration: PerJointPositive = angle("rad/s² or m/s²", "1.25 /s times the rate limit")
    """per joint; a URDF has no place for it, and this is the paper's ratio"""
    torque: PerJointPositive = key("N m or N", "the URDF's", "per joint")


class TargetTable(Keys):
    """The table [target]: the goal of the end effector."""

    position: Vector3 = key("m", "", "of the end effector")
    rpy: Vector3 = angle("rad", "any attitude")
    """attitude of the end-effector frame: roll, pitch and yaw, about the axes of `relative_to`"""
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"')
    """what position, attitude and velocities are given in: "inertial" axes; the frame of the "base", or of
    the end effector ("start"), each where it is at the start of the motion. The target does not move with
    them"""
    velocity: Vector3 = key("m/s", "0")
    """the target moves: it is at `position` at the start, and the end effector meets it at the deadline with
    this velocity"""
    spin: Vector3 = angle("rad/s", "0")
    """the target turns: its attitude is `rpy` at the start, and its angular velocity is this"""
    arrival_velocity: Vector3 = key("m/s", "0", "of the end effector at the deadline, at a target at rest")
    arrival_spin: Vector3 = angle("rad/s", "0")
    """its angular velocity then; needs `rpy` and `arrival_velocity`"""
    tolerance: Positive = key("m, rad, m/s, rad/s", "1e-3", "at the deadline, see `opt.Goal`")
    orientation_reach: Positive = angle("rad", "0.02", "how far its attitude may be off in the last tenth")


class AlsoTable(Keys):
    """The table [[also]]: the goal of another frame."""

    frame: Text = key("", "", "name of a frame of the robot: a link or a joint", required=True)
    position: Vector3 = key("m", "", "where it should be; it stands still", required=True)
    rpy: Vector3 = angle("rad", "any attitude", "its attitude, as for [target]")
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"')
    """as for [target]; "start" is this frame itself at the start of the motion"""
    tolerance: Positive = key("m, rad", "1e-3", "at the deadline")
    reach: Positive = key("m", "0.02", "how far it may be off in the last tenth of the time")
    orientation_reach: Positive = angle("rad", "0.02", "how far its attitude may be off then")


_Path: Any = table_of(
    opt.Path,
    defaults={"free_axis": "none; with `faces` [0, 0, 1]"},
    curve=(
        Annotated[str, OneOf(tuple(CURVES))],
        key(
            "",
            "",
            '"line": from the origin of its axes to `end`; "circle": about their z axis, from their x axis '
            'on; "helix": a circle that rises along z, by as much below the origin as above; '
            '"rounded-square": about their z axis, from the middle of the side at +x on; "points": splines '
            "through `points`",
            required=True,
        ),
    ),
    frame=(
        Literal["inertial", "base", "client"],
        key("", '"inertial"', "what the curve is fixed to, as `opt.Path` has it"),
    ),
    position=(Vector3, key("m", "0", "the origin of the curve's axes in those of `frame`")),
    rpy=(Vector3, angle("rad", "0", "and their roll, pitch and yaw")),
    relative_to=(
        Literal["frame", "start"],
        key(
            "",
            '"frame"',
            '"start": `position` and `rpy` count from the end effector at the start of the motion',
        ),
    ),
    end=(Vector3, key("m", "", "of a line")),
    radius=(Positive, key("m", "", "of a circle or a helix")),
    rise=(Number, key("m", "", "of a helix: from its first point to its last one, along z")),
    turns=(Number, key("", "1", "of a circle or a helix; below zero the other way round")),
    side=(Positive, key("m", "", "of a rounded square")),
    corner=(Positive, key("m", "", "the radius of its corners")),
    points=(Rows, key("m", "", "positions, in the curve's axes")),
    file=(
        Text,
        key(
            "",
            "",
            "in place of `points` and `times`: a CSV file, a path from this file's folder, with columns "
            "x, y, z [m] and, if they are wanted, t [s] and an attitude qx, qy, qz, qw, named in its first "
            "line",
        ),
    ),
    attitude=(Vector3, angle("rad", "any", "of the end effector, in the curve's axes: roll, pitch and yaw")),
    faces=(
        Literal["axis", "centre"],
        key("", "nothing", "where `free_axis` points: to the z axis of the curve's axes, or to their origin"),
    ),
)


class ClientTable(Keys):
    """The table [client]: a free rigid body that is met and captured, or looked at along a [path]."""

    mass: Positive = key("kg", "", "", required=True)
    inertia: Inertia = key("kg m²", "", required=True)
    """about its centre of mass: the principal ones along its axes, or a 3 x 3 matrix"""
    position: Vector3 = key("m", "", "where its centre of mass is at the start")
    rpy: Vector3 = angle("rad", "0", "and its roll, pitch and yaw")
    joints: Numbers = angle("rad or m", "")
    """in place of these: at the deadline its grasp is where a straight move to these joints ends"""
    velocity: Vector3 = key("m/s", "0")
    """of its centre of mass, inertial axes; at the start, or with `joints` at the deadline"""
    spin: Vector3 = angle("rad/s", "0", "its angular velocity, at the same time")
    size: Sizes3 = key("m", "")
    """sides of the box that is drawn; it is kept clear of only as an [[obstacle]] with on = "client"."""
    sensor: _Sensor = table()
    belief: _Belief = table()


_Via: Any = table_of(
    opt.Waypoint,
    defaults={"name": '"via 1", ...'},
    position=(Vector3, key("m", "", "where", required=True)),
    rpy=(Vector3, angle("rad", "any attitude", "attitude of the end effector there, as for [target]")),
    relative_to=(Literal["inertial", "base", "start"], key("", '"inertial"', "as for [target]")),
)
_OF_PLANT = "as [plant] has it"  # as large as what [plant.random] draws, and as what [plant] sets
_Contact: Any = table_of(
    Procedure,
    base=table_of(Grip),
    kind=(
        Literal["rigid", "compliant"],
        key("", '"rigid"', 'a weld at once; "compliant": a spring and a damper for a while, then a weld'),
    ),
    envelope=(table_of(Envelope), table()),
    go=(table_of(GoLimits), table()),
    masses=(
        table_of(MassUncertainty, defaults=dict.fromkeys(("arm", "base", "base_inertia"), _OF_PLANT)),
        table(),
    ),
    nozzle=(table_of(Nozzle), table()),
    ring=(table_of(Ring), table()),
)


class ObstacleTable(Keys):
    """The table [[obstacle]]: a body to keep clear of."""

    shape: Literal["box", "sphere", "cylinder", "capsule", "mesh"] = key("", "", required=True)
    """"box", "sphere", "cylinder", "capsule", "mesh"."""
    size: Sizes3 = key("m", "", "of a box: its three sides")
    radius: Positive = key("m", "", "of a sphere, cylinder or capsule")
    length: Positive = key("m", "")
    """of a cylinder along its z axis, and of a capsule between the centres of its ends"""
    file: Text = key("", "", "of a mesh, which must be convex: a path from the file's folder")
    scale: Positive = key("", "1", "of a mesh")
    position: Vector3 = key("m", "0", "of the shape's centre (of a mesh's origin)")
    rpy: Vector3 = angle("rad", "0", "its roll, pitch and yaw, as in a URDF")
    on: Literal["inertial", "base", "client"] = key("", '"inertial"')
    """what position and attitude are fixed to: "inertial" axes, the "base" link's frame, or the "client"'s"""
    margin: NotNegative = key("m", "0", "what is kept beyond the clearance")
    name: Text = key("", "", "for messages. Default: the shape and its place in the list")


class PlanTable(Keys):
    """The table [plan]: options of the plan."""

    duration: Positive = key("s", "12")
    """time to arrive. Ours: 1.5 to 3 times what the joint limits need in the paper's cases"""
    dt: Positive = key("s", "0.01", "planning step. Ours; the paper states none")
    kappa: Positive = key("", "10", "sharpness of the paper's C~. Ours: close to max(0, cos(theta_a))")
    method: Annotated[str, OneOf(opt.METHODS)] = key("", '"horizon"')
    """one of `opt.METHODS`; the others are there for comparison"""
    reach: Positive = key("m", "0.02")
    """the paper's r_th. A plan that is within it from 0.9 T on has reached; a closed loop that ends within it
    has arrived"""
    momentum: Vector6 = key("kg m/s, kg m²/s", "none")
    """total momentum (6 numbers) about the centre of mass that the plan counts on, and that the plant then
    has"""
    effort: NotNegative = key("", "1e-4", 'weight on joint travel: `opt.Effort`; for "horizon"')
    base: NotNegative = key("", "0", 'weight on the turning of the base: `opt.BaseTurn`; for "horizon"')
    time_limit: Positive = key("s", "none")
    """after so long the best plan so far is taken; for "horizon". The plan then depends on how fast the
    machine is"""
    locked: Texts = key("", "[]")
    """names of joints that cannot move, in the plan and in re-planning; for "horizon"."""
    mode: Annotated[str, OneOf(("floating", *HELD_BY))] = key("", '"floating"')
    """what of the base is held, as `opt.Problem` has it: with "rotation-floating" the attitude, by wheels,
    with "rotation-flying" by thrusters; with "translation-flying" the place of its centre of mass, and with
    "flying" both, by thrusters and `law = "station-keeping"` ([the base](bases-that-act.md)). It needs
    a table [attitude]"""
    base_limits: _BaseLimits = table()


class ControlTable(Keys):
    """The table [control]: the joints' law and its gains."""

    law: Annotated[str, OneOf(tuple(LAWS))] = key("", '"sliding-mode"')
    """"sliding-mode" (the paper's), "computed-torque", "pd", "impedance" or "admittance"; the last two are in
    [contact](contact.md)"""
    K_s: Gain = key("N m", "0.001", 'switching gain of "sliding-mode"')
    K_p: Gain = key("1/s² or N m/rad", "the law's")
    """stiffness of "computed-torque" (25), "pd" (0.5), "admittance" (400)"""
    K_d: Gain = key("1/s, N m s/rad", "the law's", "damping of these (10, 0.5, 40)")
    coulomb: PerJointNotNegative = key(
        "N m", "the robot's", 'of "computed-torque": the friction it compensates'
    )
    viscous: PerJointNotNegative = key(
        "N m s/rad", "the robot's", "of it: the viscous friction it compensates"
    )
    learn_friction: bool = key("", "true", 'of "computed-torque"; false with [client]')
    Gamma: Gain = key("1/s", "10", "slope of the sliding surface")
    boundary: PerJointPositive = key("rad/s", "0.02", "lambda, half the boundary layer's width; per joint")
    stiffness: PerJointPositive = key("N/m", "200", 'of "impedance", "admittance": one, or one an axis')
    turn_stiffness: PerJointPositive = key("N m/rad", "10", "of these two as well, about the axes")
    damping_ratio: NotNegative = key("", "1", "of these two: of every mode")
    posture_stiffness: Positive = key("N m/rad", "5", "of these: of what leaves the end effector still")
    force_limit: Bound = key("N", "20", "of these: largest force of a contact at rest; may be inf")
    mass: Positive = key("kg", "10", 'of "admittance"')
    inertia: Positive = key("kg m²", "0.2", 'of "admittance", about any axis')
    torque_limit: PerJointLimit = key("N m or N", "[limits] torque", "cut off there; per joint, may be inf")
    dt: Positive = key("s", "0.001", "control and integration step; the torque is held for it")
    offset: PerJoint = angle("rad or m", "0")
    """how far from the plan's start the simulated arm starts; per joint"""


class AttitudeTable(Keys):
    """The table [attitude]: the law of the base."""

    law: Literal["quaternion", "coordinated", "station-keeping"] = key("", '"quaternion"')
    """"quaternion": feedback, beside any law of [control]; "coordinated": arm and base by one model, with
    `law = "computed-torque"` and its gains under [control]; "station-keeping": thrusters hold the base's
    place too"""
    holds: Literal["both", "place"] = key("", '"both"')
    """of "station-keeping": "both", place and attitude, for `mode = "flying"`; "place", for `mode =
    "translation-flying"`"""
    bandwidth: Positive = key("rad/s", "1", "of the attitude loop")
    damping: Positive = key("", "1", "1 is critical")
    feedforward: Literal["torque", "plan", "none"] = key("", '"torque"')
    """of "quaternion": "torque", the reaction to the joint torques; "plan", to the planned joint motion;
    "none"."""
    attitude: Vector3 = angle("rad", "that at the start", "roll, pitch, yaw of the root frame to hold")
    place: Vector3 = key("m", "that at the start")
    """of "station-keeping": the base's centre of mass to hold, inertial axes"""
    dump: _Dump = table()


_Reference: Any = table_of(
    Replan,
    kind=(
        Literal["plan", "re-planning"],
        key(
            "",
            '"plan"',
            '"plan": the plan made once; "re-planning": the motion is planned anew from the measured state, '
            "as by `opt.Replanning`. The plan made once is then simulated beside it",
        ),
    ),
    hold=(NotNegative, key("s", "0", "how long to stay at the target after the arrival")),
)


class RandomPlantTable(Keys):
    """The table [plant.random]: a plant that is drawn round that of [plant]."""

    seed: Whole = key("", "", "of the draw: the same seed, the same plant", required=True)
    arm_mass: NotNegative = key("", "0.2")
    """by what share each body's mass, inertia with it, is off at most: what is known of an arm with its
    harness"""
    base_mass: NotNegative = key("", "0.1", "the same for the base: fuel is burnt")
    base_inertia: NotNegative = key("", "0.1", "the same for its inertia")


class LearnTable(Keys):
    """The table [learn]: bodies whose inertial parameters re-planning identifies from the motion."""

    unknown: Texts = key("", "", required=True)
    """"base", "payload" (a body fixed to the end effector's link), and names of links or joints"""
    spread: Positive = key("", "1", "deviation of what is believed, as a share of mass and inertia")
    at_rest: bool = key("", "false", "true: the total momentum is zero for certain; false: it is unknown")


class CampaignTable(Keys):
    """The table [campaign]: the draws of `ffsms-pin campaign`; a single run does not use it."""

    seed: Whole = key("", "1", "of the first run; the others follow")
    draw: dict[str, Any] = key("", "")
    """a table: distributions by key of this file, as `plant.arm_mass = { uniform = [0.8, 1.2] }`"""


_TABLES: dict[str, Any] = {
    "robot": RobotTable,
    "start": StartTable,
    "target": TargetTable,
    "also": list[AlsoTable],
    "via": list[_Via],
    "path": _Path,
    "client": ClientTable,
    "meet": table_of(
        opt.Meet,
        grasp=(
            Vector3,
            key("m", "0", "place of the grasp frame in the client's axes, from its centre of mass"),
        ),
        grasp_rpy=(Vector3, angle("rad", "0", "its roll, pitch and yaw against the client's axes")),
    ),
    "contact": _Contact,
    "plan": table_of(opt.Clearance, base=PlanTable),
    "term": list[TermTable],
    "limit": list[LimitTable],
    "obstacle": list[ObstacleTable],
    "limits": LimitsTable,
    "control": ControlTable,
    "reference": _Reference,
    "simulation": table_of(
        simulation.Conditions,
        defaults={"momentum": "[plan] momentum"},
        q0=(
            Numbers,
            key(
                "",
                "the plan's start",
                "configuration at the start (nq numbers), Pinocchio's: base position, quaternion "
                "(x, y, z, w), joints",
            ),
        ),
    ),
    "plant": table_of(
        simulation.InertialError,
        model=(Text, key("", "the model", "another robot with the same joints, as under [robot]")),
        end_effector=(Text, key("", "the model's", "its frame; needs `model`")),
        random=(RandomPlantTable, table()),
    ),
    "wheels": table_of(ReactionWheels),
    "thrusters": table_of(Thrusters),
    "attitude": AttitudeTable,
    "friction": table_of(simulation.JointFriction),
    "actuator": table_of(simulation.Actuator),
    "sensors": table_of(simulation.Sensors),
    "wrist": table_of(simulation.WristSensor),
    "estimator": table_of(
        simulation.Estimator, on=(bool, key("", "true", "false: the measurements are shown as they are"))
    ),
    "disturbance": list[table_of(simulation.Wrench)],  # type: ignore[misc]  # made here
    "capture": list[table_of(simulation.Capture)],  # type: ignore[misc]
    "fault": list[table_of(simulation.JointFault)],  # type: ignore[misc]
    "guards": table_of(
        simulation.Guards,
        defaults={f"contact_{name}": f"[contact.envelope] {name}, else inf" for name in ("force", "torque")},
        on=(bool, key("", "true", "false: no guards; only a state that is not finite ends the run")),
    ),
    "learn": LearnTable,
    "campaign": CampaignTable,
}
_REQUIRED = ("robot", "start")  # with keys that must be there, so that an absent table is missing these

_FIELDS: dict[str, Any] = {
    name: (kind, Field({}, validate_default=True) if name in _REQUIRED else table())
    for name, kind in _TABLES.items()
}
ScenarioFile: type[Keys] = create_model("ScenarioFile", __base__=MadeKeys, **_FIELDS)
"""The tables of a scenario file by name."""
ScenarioFile.__doc__ = "A scenario: robot, task, plan, control, and what the real satellite does differently."

# Tables whose absence is another thing than a table without keys.
NONE_IF_ABSENT = ("path", "client", "meet", "wheels", "thrusters", "attitude", "wrist", "learn")


def is_table(path: str) -> bool:
    """Return whether a key is a table, as "attitude.dump"."""
    model: type[Keys] = ScenarioFile
    for step in path.split("."):
        field = model.model_fields.get(step)
        inner = [] if field is None else models_in(field.annotation)
        if not inner:
            return False
        model = inner[0]
    return True
