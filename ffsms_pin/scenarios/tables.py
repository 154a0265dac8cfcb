"""The tables of a scenario file: options of the library's classes, and keys that only files have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from ffsms_pin import opt, simulation
from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.capture.camera import Camera
from ffsms_pin.capture.go_no_go import GoLimits
from ffsms_pin.capture.mass_uncertainty import MassUncertainty
from ffsms_pin.capture.options import Belief, Grip, Nozzle, Replan, Ring
from ffsms_pin.capture.prediction import Envelope
from ffsms_pin.capture.procedure import Procedure
from ffsms_pin.client import Client
from ffsms_pin.control import LAWS, Coordinated, MomentumDump, QuaternionFeedback, StationKeeping
from ffsms_pin.identification import Identifier
from ffsms_pin.opt.goals.named_curves import CurvePlacement
from ffsms_pin.opt.problem import default_terms
from ffsms_pin.options import *
from ffsms_pin.options.tables import FileKeys, Keys, by_name, file_of, table_of, tables_by
from ffsms_pin.robot import SatelliteBase, load
from ffsms_pin.system import RobotLimits

DEFAULT_LAW = "sliding-mode"
STATION_KEEPING = "station-keeping"  # the law that holds the base's position, too
BASE_LAWS: dict[str, Any] = {
    "quaternion": QuaternionFeedback,
    "coordinated": Coordinated,
    STATION_KEEPING: StationKeeping,
}
SHAPES: dict[str, Any] = {
    "box": opt.Obstacle.box,
    "sphere": opt.Obstacle.sphere,
    "cylinder": opt.Obstacle.cylinder,
    "capsule": opt.Obstacle.capsule,
    "mesh": opt.Obstacle.mesh,
}
CURVES: dict[str, Any] = {
    "line": opt.Line,
    "circle": opt.Circle,
    "helix": opt.Helix,
    "rounded-square": opt.RoundedSquare,
}
_OF_PLANT = dict.fromkeys(("arm", "base", "base_inertia"), "that of [plant] and [plant.random]")
_MASSES: Any = table_of(MassUncertainty, defaults=_OF_PLANT)


class MountTable(FileKeys):
    """The table [robot.mount]: the satellite that an arm is mounted on."""

    position: Annotated[Vector3, Unit("m", "centre of the +x face")] = None
    """position of the arm's root link in the base frame, whose origin is the centre of the satellite's box"""
    rpy: Annotated[Vector3, Angle("rad", "[0, 1.5708, 0]")] = None
    """roll, pitch and yaw of the arm's root link. Default: the arm's z axis along the base's x axis"""


class RobotTable(FileKeys):
    """The table [robot]: the robot, by name or file."""

    model: Annotated[Text, Unit()]
    """a packaged robot, such as `planar_3r` or `satellite_panda`, or the path of a URDF or MJCF file,
    relative to the scenario file's folder"""
    mount: Annotated[Any, table_of(MountTable, SatelliteBase)] = None


class StartTable(FileKeys):
    """The table [start]: the joints' positions and rates at the start.

    At the start the base's axes are parallel to the inertial axes. The inertial origin is at the system's
    centre of mass.
    """

    joints: Annotated[Numbers, Angle("rad or m")]
    """joint positions at the start, one per joint"""
    joint_rates: Annotated[PerJoint, Angle("rad/s or m/s", "0")] = None
    """joint rates at the start of plan and closed loop; per joint"""


class PlaceTable(FileKeys):
    """A desired pose of a frame of the robot."""

    position: Annotated[Vector3, Unit("m")]
    """desired position of the frame"""
    rpy: Annotated[Vector3, Angle("rad", "any attitude")] = None
    """desired attitude of the frame: roll, pitch and yaw about the axes of `relative_to`"""
    relative_to: Annotated[Literal["inertial", "base", "start"], Unit()] = "inertial"
    """axes of `position`, `rpy` and, in [target], the velocities: "inertial"; "base" (the base link's frame
    at the start of the motion); or "start" (the pose of the goal's frame at the start). The axes do not move
    with the base"""


class TargetTable(PlaceTable):
    """The table [target]: the goal of the end effector."""

    position: Annotated[Vector3, Unit("m")] = None
    """desired position of the end effector"""
    velocity: Annotated[Vector3, Unit("m/s", "0")] = None
    """velocity of a moving target, which is at `position` at the start; the end effector meets it at the
    deadline with this velocity"""
    spin: Annotated[Vector3, Angle("rad/s", "0")] = None
    """angular velocity of a rotating target, whose attitude is `rpy` at the start"""
    arrival_velocity: Annotated[Vector3, Unit("m/s", "0")] = None
    """end-effector velocity at the deadline, for a target at rest"""
    arrival_spin: Annotated[Vector3, Angle("rad/s", "0")] = None
    """end-effector angular velocity at the deadline; needs `rpy` and `arrival_velocity`"""


class AlsoTable(PlaceTable):
    """The table [[also]]: the goal of another frame."""

    position: Annotated[Vector3, Unit("m")]
    """desired position of the frame, at rest"""
    frame: Annotated[Text, Unit()]
    """name of a frame of the robot: a link or a joint"""


class PathTable(FileKeys):
    """The table [path]: a curve that the end effector follows."""

    curve: Annotated[Text, Unit()]
    """"line": from the origin of the curve's axes to `end`; "circle": about the z axis, beginning on the x
    axis; "helix": a circle that rises along z, with the origin at half its height; "rounded-square": about
    the z axis, beginning in the middle of the side at +x; "points": splines through `points`"""
    frame: Annotated[Literal["inertial", "base", "client"], Unit()] = "inertial"
    """frame to which the curve is fixed, as in `opt.Path`"""
    position: Annotated[Vector3, Unit("m", "0")] = None
    """origin of the curve's axes in the axes of `frame`"""
    rpy: Annotated[Vector3, Angle("rad", "0")] = None
    """roll, pitch and yaw of the curve's axes"""
    relative_to: Annotated[Literal["frame", "start"], Unit()] = "frame"
    """"frame": `position` and `rpy` are in the axes of `frame`; "start": they are in the axes of the end
    effector at the start of the motion"""
    attitude: Annotated[Vector3, Angle("rad", "any")] = None
    """roll, pitch and yaw of the end effector in the curve's axes"""


class PointsTable(PathTable):
    """The table [path] with `curve = "points"`."""

    points: Annotated[Rows, Unit("m")] = None
    """positions, in the curve's axes"""
    file: Annotated[Text | None, Unit()] = None
    """CSV file that replaces `points` and `times`; its path is relative to the scenario file's folder. The
    first line names the columns: x, y, z [m] and, optionally, t [s] and an attitude qx, qy, qz, qw"""
    times: Annotated[Numbers, Unit("s", "none: a geometric curve")] = None
    """times of the points, beginning at zero. If the motion ends before the last point, the rest of the path
    is not followed, and the plan has a note"""


class ClientTable(FileKeys):
    """The table [client]: a free rigid body that is met and captured, or inspected along a [path]."""

    position: Annotated[Vector3, Unit("m")] = None
    """position of the client's centre of mass at the start"""
    rpy: Annotated[Vector3, Angle("rad", "0")] = None
    """roll, pitch and yaw of the client at the start"""
    joints: Annotated[Numbers, Angle("rad or m")] = None
    """joint positions that define the client's pose, instead of `position` and `rpy`: a straight joint-space
    motion to these joint positions brings the end effector to the grasp at the deadline"""
    velocity: Annotated[Vector3, Unit("m/s", "0")] = None
    """velocity of the client's centre of mass in inertial axes: at the start of the motion, or at the
    deadline if `joints` is set"""
    spin: Annotated[Vector3, Angle("rad/s", "0")] = None
    """angular velocity of the client at the time of `velocity`"""
    size: Annotated[Sizes3, Unit("m")] = None
    """sides of the drawn box. Plans ignore it, and keep clear of an [[obstacle]] with on = "client". If the
    client has no such obstacle, the clearance of a capture's flight is measured to this box"""
    sensor: Annotated[Any, table_of(Camera)] = None
    belief: Annotated[Any, table_of(Belief)] = None


class MeetTable(FileKeys):
    """The table [meet]: the rendezvous of the end effector with the client."""

    grasp: Annotated[Vector3, Unit("m", "0")] = None
    """grasp frame's position in the client's axes, from its centre of mass"""
    grasp_rpy: Annotated[Vector3, Angle("rad", "0")] = None
    """grasp frame's roll, pitch and yaw relative to the client's axes"""


class ContactTable(FileKeys):
    """The table [contact]: the contact with the client, and the motion after it."""

    kind: Annotated[Text, Unit()] = "rigid"
    """"rigid": the grip is rigid from the contact on; "compliant": it is first a spring with a damper, then
    rigid"""
    envelope: Annotated[Any, table_of(Envelope)] = None
    go: Annotated[Any, table_of(GoLimits)] = None
    masses: Annotated[Any, _MASSES] = None
    nozzle: Annotated[Any, table_of(Nozzle)] = None
    ring: Annotated[Any, table_of(Ring)] = None


class ObstacleTable(FileKeys):
    """The table [[obstacle]]: a body that the robot must not touch."""

    shape: Annotated[Text, Unit()]
    """shape of the obstacle: "box", "sphere", "cylinder", "capsule" or "mesh"."""
    position: Annotated[Vector3, Unit("m", "0")] = None
    """position of the shape's centre, or of a mesh's origin, in the axes of `on`"""
    rpy: Annotated[Vector3, Angle("rad", "0")] = None
    """roll, pitch and yaw of the shape, as in a URDF"""
    on: Annotated[Literal["inertial", "base", "client"], Unit()] = "inertial"
    """frame to which the obstacle is fixed: "inertial", "base" or "client"."""


class PlanTable(FileKeys):
    """The table [plan]: options of the plan."""

    method: Annotated[str, OneOf(opt.METHODS), Unit()] = "horizon"
    """one of `opt.METHODS`; methods other than "horizon" are for comparison"""
    reach: Annotated[Positive, Unit("m")] = opt.Pose.reach
    """the paper's r_th, the position tolerance: in a plan the end effector must stay within this distance of
    the target in the last tenth of the duration; in a closed loop it must end within this distance"""
    base_limits: Annotated[Any, table_of(opt.BaseLimits)] = None


class ControlTable(FileKeys):
    """The table [control]: the joints' law and its gains."""

    law: Annotated[Text, Unit()] = DEFAULT_LAW
    """"sliding-mode" (the paper's), "computed-torque", "pd", "impedance" or "admittance"; see
    [contact](contact.md) for the last two"""
    torque_limit: Annotated[PerJointLimit, Unit("N m or N", "[limits] torque")] = None
    """torque saturation; per joint, may be inf"""
    dt: Annotated[Positive, Unit("s")] = 0.001
    """control step, in which the commanded torque is constant; by default also the integration step"""
    offset: Annotated[PerJoint, Angle("rad or m", "0")] = None
    """simulated minus planned joint positions at the start; per joint"""


class AttitudeTable(FileKeys):
    """The table [attitude]: the law of the base."""

    law: Annotated[Text, Unit()] = "quaternion"
    """"quaternion": attitude feedback, with any law of [control]; "coordinated": one model-based law for arm
    and base, with `law = "computed-torque"` and its gains under [control]; "station-keeping": thrusters also
    hold the base's position, or only the position with `holds = "place"`"""
    attitude: Annotated[Vector3, Angle("rad", "that at the start")] = None
    """desired roll, pitch and yaw of the root frame"""


class DumpingTable(AttitudeTable):
    """The table [attitude] of a law that can unload the wheels by thrusters."""

    dump: Annotated[Any, table_of(MomentumDump)] = None


class ReferenceTable(FileKeys):
    """The table [reference]: the reference of the closed loop."""

    kind: Annotated[Text, Unit()] = "plan"
    """"plan": the plan, without changes; "re-planning": the motion is re-planned from the measured state by
    `opt.Replanning`, and a second simulation follows the first plan for comparison"""
    hold: Annotated[NotNegative, Unit("s")] = 0.0
    """time for which the target is held after the arrival"""


class SimulationTable(FileKeys):
    """The table [simulation]: the plant's start, and its integration."""

    q0: Annotated[Numbers, Unit("", "the plan's start")] = None
    """configuration at the start (nq numbers) in Pinocchio's layout: base position, quaternion (x, y, z, w),
    joints"""


class RandomPlantTable(FileKeys):
    """The table [plant.random]: random errors of masses and inertias, besides the errors in [plant]."""

    seed: Annotated[Whole, Unit()]
    """seed of the draw; equal seeds give equal plants"""


class PlantTable(FileKeys):
    """The table [plant]: the simulated robot, if it differs from the model."""

    model: Annotated[Text | None, Unit("", "the model")] = None
    """another robot with the same joints; a name or path as in [robot]"""
    end_effector: Annotated[Text | None, Unit("", "the model's")] = None
    """end-effector frame of that robot; needs `model`"""
    random: Annotated[Any, table_of(RandomPlantTable, simulation.random_plants)] = None


class EstimatorTable(FileKeys):
    """The table [estimator]: the filter of the measurements."""

    on: Annotated[bool, Unit()] = True
    """false: the measurements are used without a filter"""


class GuardsTable(FileKeys):
    """The table [guards]: limits that stop a run."""

    on: Annotated[bool, Unit()] = True
    """false: no guards; a state that is not finite still ends the run"""


class CampaignTable(FileKeys):
    """The table [campaign]: the draws of `ffsms-pin campaign`; a single run does not use it."""

    seed: Annotated[Whole, Unit()] = 1
    """seed of the first run; further runs have consecutive seeds"""
    draw: Annotated[Any, Table(), Unit()] = None
    """distributions by key of this file, such as `plant.arm_mass = { uniform = [0.8, 1.2] }`"""


class PartTable(FileKeys):
    """The tables [[term]] and [[limit]]."""

    use: Annotated[Text, Unit()]
    """name of one of the library's terms or limits"""


class OwnPart(FileKeys):
    """A term or limit of a user's own class; its further keys are the keyword arguments of the class."""

    use: Annotated[str, Name(pattern=":"), Unit()]
    """a class of your own, written "package.module:Class"."""


_TERMS = (
    *(opt.Coupling, opt.Smooth, opt.Effort, opt.BaseTurn),
    *(opt.WheelMomentum, opt.WheelEnergy, opt.Propellant),
)
_LIMITS = (
    *(opt.JointLimits, opt.Clearance, opt.BaseLimits),
    *(opt.AlphaBox, opt.TorqueLimits, opt.WheelLimits),
)

PACKAGED: Mapping[str, Mapping[str, Any]] = {"term": by_name(_TERMS), "limit": by_name(_LIMITS)}
"""The packaged terms and limits by their names in a scenario file."""


_OF_ROBOT = dict.fromkeys(("lower", "upper", "velocity", "acceleration", "torque"), "the robot's")
_OF_ENVELOPE = {
    "contact_force": "[contact.envelope] force, else inf",
    "contact_torque": "[contact.envelope] torque, else inf",
}

_PATHS: Any = tables_by(
    "curve",
    PathTable,
    {**CURVES, "points": CurvePlacement},
    opt.Path,
    bases={"points": PointsTable},
    omit=("times",),  # a key of `PointsTable`
    defaults={"free_axis": "none; with `faces` [0, 0, 1]"},
)
_TABLES: dict[str, Any] = {
    "robot": table_of(RobotTable, load),
    "start": table_of(StartTable),
    "target": table_of(TargetTable, opt.Pose, omit=("reach",)),  # `reach` is a key of [plan]
    "also": list[table_of(AlsoTable, opt.Pose)],  # type: ignore[misc]  # a class made at import
    "via": list[table_of(PlaceTable, opt.Waypoint, defaults={"name": '"via 1", ...'})],  # type: ignore[misc]
    "path": _PATHS,
    "client": table_of(ClientTable, Client),
    "meet": table_of(MeetTable, opt.Meet),
    "contact": tables_by("kind", ContactTable, {"rigid": None, "compliant": Grip}, Procedure),
    "plan": table_of(PlanTable, opt.Problem, default_terms, opt.SearchOptions, opt.Clearance),
    "term": list[tables_by("use", PartTable, PACKAGED["term"], own=OwnPart)],  # type: ignore[misc]
    "limit": list[tables_by("use", PartTable, PACKAGED["limit"], own=OwnPart)],  # type: ignore[misc]
    "obstacle": list[tables_by("shape", ObstacleTable, SHAPES, opt.Obstacle)],  # type: ignore[misc]
    "limits": table_of(RobotLimits, defaults=_OF_ROBOT),
    "control": tables_by("law", ControlTable, LAWS),
    "reference": tables_by("kind", ReferenceTable, {"plan": None, "re-planning": Replan}),
    "simulation": table_of(SimulationTable, simulation.Conditions, defaults={"momentum": "[plan] momentum"}),
    "plant": table_of(PlantTable, simulation.InertialError),
    "wheels": table_of(ReactionWheels),
    "thrusters": table_of(Thrusters),
    "attitude": tables_by("law", DumpingTable, BASE_LAWS, bases={STATION_KEEPING: AttitudeTable}),
    "friction": table_of(simulation.JointFriction),
    "actuator": table_of(simulation.Actuator),
    "sensors": table_of(simulation.Sensors),
    "wrist": table_of(simulation.WristSensor),
    "estimator": table_of(EstimatorTable, simulation.Estimator),
    "disturbance": list[table_of(simulation.Wrench)],  # type: ignore[misc]
    "capture": list[table_of(simulation.Capture)],  # type: ignore[misc]
    "fault": list[table_of(simulation.JointFault)],  # type: ignore[misc]
    "guards": table_of(GuardsTable, simulation.Guards, defaults=_OF_ENVELOPE),
    "learn": table_of(Identifier),
    "campaign": table_of(CampaignTable),
}
# Tables with required keys, which are reported as missing if the table is absent.
_REQUIRED = ("robot", "start")

_ABOUT = "A scenario: robot, task, plan, control, and the conditions of the closed loop."
ScenarioFile: type[Keys] = file_of(_TABLES, "ScenarioFile", _ABOUT, required=_REQUIRED)
"""The tables of a scenario file by name."""

# Tables that may be empty; an empty table has another meaning than a missing table.
NONE_IF_ABSENT = ("path", "client", "meet", "wheels", "thrusters", "attitude", "wrist", "learn")
