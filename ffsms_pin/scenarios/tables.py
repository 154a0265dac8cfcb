"""The tables of a scenario file, from options of the library and keys only of the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, WithJsonSchema

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
from ffsms_pin.robot import SatelliteBase, load
from ffsms_pin.scenarios.keys import *
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
_Sensor: Any = table_of(Camera)
_Belief: Any = table_of(Belief)
_Envelope: Any = table_of(Envelope)
_Go: Any = table_of(GoLimits)
_Nozzle: Any = table_of(Nozzle)
_Ring: Any = table_of(Ring)
_BaseLimits: Any = table_of(opt.BaseLimits)
_Dump: Any = table_of(MomentumDump)
_OF_PLANT = "that of [plant] and [plant.random]"
_Masses: Any = table_of(MassUncertainty, defaults=dict.fromkeys(("arm", "base", "base_inertia"), _OF_PLANT))


class MountTable(Keys):
    """The table [robot.mount]: the satellite that an arm is mounted on."""

    position: Vector3 = key("m", "centre of the +x face")
    """position of the arm's root link in the base frame, whose origin is the box's centre"""
    rpy: Vector3 = angle("rad", "[0, 1.5708, 0]")
    """roll, pitch and yaw of the arm's root link. Default: the arm's z axis along the base's x axis"""


_Mount: Any = table_of(SatelliteBase, base=MountTable)


class RobotTable(Keys):
    """The table [robot]: the robot, by name or file."""

    model: Text = key("", "", required=True)
    """a packaged robot, such as `planar_3r` or `satellite_panda`, or the path of a URDF, relative to the
    scenario file's folder"""
    mount: _Mount = table()


class StartTable(Keys):
    """The table [start]: the joints; base axes are inertial, the system's centre of mass at their origin."""

    joints: Numbers = angle("rad or m", "", "joint positions at the start, one per joint", required=True)
    joint_rates: PerJoint = angle("rad/s or m/s", "0")
    """joint rates at the start of plan and closed loop; per joint"""


class PlaceTable(Keys):
    """A desired pose of a frame of the robot."""

    position: Vector3 = key("m", "", "desired position of the frame, at rest", required=True)
    rpy: Vector3 = angle("rad", "any attitude")
    """desired attitude of the frame: roll, pitch and yaw about the axes of `relative_to`"""
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"')
    """axes of `position` and `rpy`: "inertial"; "base", the base link's frame at the start of the motion; or
    "start", this frame itself at the start. The desired pose does not move with the base"""


class TargetTable(PlaceTable):
    """The table [target]: the goal of the end effector."""

    position: Vector3 = key("m", "", "desired position of the end effector")
    velocity: Vector3 = key("m/s", "0")
    """velocity of a moving target, which is at `position` at the start; the end effector meets it at the
    deadline with this velocity"""
    spin: Vector3 = angle("rad/s", "0")
    """angular velocity of a rotating target, whose attitude is `rpy` at the start"""
    arrival_velocity: Vector3 = key("m/s", "0", "end-effector velocity at the deadline, for a target at rest")
    arrival_spin: Vector3 = angle("rad/s", "0")
    """end-effector angular velocity at the deadline; needs `rpy` and `arrival_velocity`"""


class AlsoTable(PlaceTable):
    """The table [[also]]: the goal of another frame."""

    frame: Text = key("", "", "name of a frame of the robot: a link or a joint", required=True)


class PathTable(Keys):
    """The table [path]: a curve that the end effector follows."""

    curve: Text = key("", "", required=True)
    """"line": from the origin of the curve's axes to `end`; "circle": about the z axis, beginning on the x
    axis; "helix": a circle that rises along z, with the origin at half its height; "rounded-square": about
    the z axis, beginning in the middle of the side at +x; "points": splines through `points`"""
    frame: Literal["inertial", "base", "client"] = key("", '"inertial"')
    """frame to which the curve is fixed, as in `opt.Path`"""
    position: Vector3 = key("m", "0", "origin of the curve's axes in the axes of `frame`")
    rpy: Vector3 = angle("rad", "0", "roll, pitch and yaw of the curve's axes")
    relative_to: Literal["frame", "start"] = key("", '"frame"')
    """"start": `position` and `rpy` are relative to the end effector at the start of the motion"""
    attitude: Vector3 = angle("rad", "any", "roll, pitch and yaw of the end effector in the curve's axes")


class PointsTable(PathTable):
    """The table [path] with `curve = "points"`."""

    points: Rows = key("m", "", "positions, in the curve's axes")
    file: Text = key("", "")
    """CSV file in place of `points` and `times`, relative to the scenario file's folder: columns x, y, z [m]
    and, optionally, t [s] and an attitude qx, qy, qz, qw, named in its first line"""
    times: Numbers = key("s", "none: a geometric curve")
    """times of the points, beginning at zero. If the motion ends before the last point, it does not follow
    the rest of the path, and the plan has a note"""


class ClientTable(Keys):
    """The table [client]: a free rigid body that is met and captured, or inspected along a [path]."""

    position: Vector3 = key("m", "", "position of the client's centre of mass at the start")
    rpy: Vector3 = angle("rad", "0", "roll, pitch and yaw of the client at the start")
    joints: Numbers = angle("rad or m", "")
    """joint positions that place the client, instead of `position` and `rpy`: at the deadline its grasp is
    where a straight joint-space motion to these positions brings the end effector"""
    velocity: Vector3 = key("m/s", "0")
    """velocity of the client's centre of mass, inertial axes; at the start, or with `joints` at the
    deadline"""
    spin: Vector3 = angle("rad/s", "0", "angular velocity of the client at the time of `velocity`")
    size: Sizes3 = key("m", "")
    """sides of the drawn box; clearance to the client needs an [[obstacle]] with on = "client"."""
    sensor: _Sensor = table()
    belief: _Belief = table()


class MeetTable(Keys):
    """The table [meet]: the rendezvous of the end effector with the client."""

    grasp: Vector3 = key("m", "0", "grasp frame's position in the client's axes, from its centre of mass")
    grasp_rpy: Vector3 = angle("rad", "0", "grasp frame's roll, pitch and yaw relative to the client's axes")


class ContactTable(Keys):
    """The table [contact]: the contact with the client, and the time after it."""

    kind: Text = key("", '"rigid"')
    """"rigid": the grip is rigid from the contact on; "compliant": it is a spring and a damper, then rigid"""
    envelope: _Envelope = table()
    go: _Go = table()
    masses: _Masses = table()
    nozzle: _Nozzle = table()
    ring: _Ring = table()


class ObstacleTable(Keys):
    """The table [[obstacle]]: a body that the robot must not touch."""

    shape: Text = key("", "", required=True)
    """shape of the obstacle: "box", "sphere", "cylinder", "capsule" or "mesh"."""
    position: Vector3 = key("m", "0", "position of the shape's centre, or of a mesh's origin")
    rpy: Vector3 = angle("rad", "0", "roll, pitch and yaw of the shape, as in a URDF")
    on: Literal["inertial", "base", "client"] = key("", '"inertial"')
    """frame to which the obstacle is fixed: "inertial" axes, the "base" link's or the "client"'s"""


class PlanTable(Keys):
    """The table [plan]: options of the plan."""

    method: Annotated[str, OneOf(opt.METHODS)] = key("", '"horizon"')
    """one of `opt.METHODS`; methods other than "horizon" are for comparison"""
    reach: Positive = key("m", "0.02")
    """the paper's r_th: a plan reaches its target if it stays within this distance in the last tenth of its
    duration; a closed loop arrives if it ends within this distance"""
    base_limits: _BaseLimits = table()


class ControlTable(Keys):
    """The table [control]: the joints' law and its gains."""

    law: Text = key("", f'"{DEFAULT_LAW}"')
    """"sliding-mode" (the paper's), "computed-torque", "pd", "impedance" or "admittance"; see
    [contact](contact.md) for the last two"""
    torque_limit: PerJointLimit = key(
        "N m or N", "[limits] torque", "torque saturation; per joint, may be inf"
    )
    dt: Positive = key("s", "0.001", "control and integration step; the torque is constant in a step")
    offset: PerJoint = angle("rad or m", "0")
    """deviation of the simulated arm from the plan's start; per joint"""


class AttitudeTable(Keys):
    """The table [attitude]: the law of the base."""

    law: Text = key("", '"quaternion"')
    """"quaternion": attitude feedback, with any law of [control]; "coordinated": one model-based law for arm
    and base, with `law = "computed-torque"` and its gains under [control]; "station-keeping": thrusters also
    hold the base's position"""
    attitude: Vector3 = angle("rad", "that at the start", "roll, pitch, yaw of the root frame to hold")


class DumpingTable(AttitudeTable):
    """The table [attitude] of a law that unloads the wheels by thrusters."""

    dump: _Dump = table()


class ReferenceTable(Keys):
    """The table [reference]: the reference of the closed loop."""

    kind: Text = key("", '"plan"')
    """"plan": the plan made once; "re-planning": the motion is re-planned from the measured state by
    `opt.Replanning`. The plan made once is then simulated for comparison"""
    hold: NotNegative = key("s", "0", "time for which the target is held after the arrival")


class SimulationTable(Keys):
    """The table [simulation]: the plant's start, and its integration."""

    q0: Numbers = key("", "the plan's start")
    """configuration at the start (nq numbers) in Pinocchio's layout: base position, quaternion (x, y, z, w),
    joints"""


class RandomPlantTable(Keys):
    """The table [plant.random]: a plant drawn at random around that of [plant]."""

    seed: Whole = key("", "", "seed of the draw; equal seeds give equal plants", required=True)


_Random: Any = table_of(simulation.random_plants, base=RandomPlantTable)


class PlantTable(Keys):
    """The table [plant]: the simulated robot, if it differs from the model."""

    model: Text = key("", "the model", "another robot with the same joints, as under [robot]")
    end_effector: Text = key("", "the model's", "end-effector frame of that robot; needs `model`")
    random: _Random = table()


class EstimatorTable(Keys):
    """The table [estimator]: the filter of the measurements."""

    on: bool = key("", "true", "false: the measurements are used without a filter")


class GuardsTable(Keys):
    """The table [guards]: limits of the flight."""

    on: bool = key("", "true", "false: no guards; only a state that is not finite ends the run")


class CampaignTable(Keys):
    """The table [campaign]: the draws of `ffsms-pin campaign`; a single run does not use it."""

    seed: Whole = key("", "1", "seed of the first run; further runs have consecutive seeds")
    draw: dict[str, Any] = key("", "")
    """distributions by key of this file, such as `plant.arm_mass = { uniform = [0.8, 1.2] }`"""


class PartTable(Keys):
    """The tables [[term]] and [[limit]]."""

    use: Text = key("", "", required=True)
    """name of one of the library's terms or limits"""


class OwnPart(Keys):
    """A term or limit of a user's own class; its further keys are the keyword arguments of the class."""

    model_config = ConfigDict(extra="allow")

    use: Annotated[Text, WithJsonSchema({"type": "string", "pattern": ":"})] = key(
        "", "", f'a class of your own, written "{OWN}"', required=True
    )


_TERMS = (
    *(opt.Coupling, opt.Smooth, opt.Effort, opt.BaseTurn),
    *(opt.WheelMomentum, opt.WheelEnergy, opt.Propellant),
)
_LIMITS = (
    *(opt.JointLimits, opt.Clearance, opt.BaseLimits),
    *(opt.AlphaBox, opt.TorqueLimits, opt.WheelLimits),
)

PACKAGED: Mapping[str, Mapping[str, Any]] = {
    "term": by_name(_TERMS),
    "limit": by_name(_LIMITS),
}
"""The packaged terms and limits by their names in a scenario file."""


_OF_URDF = dict.fromkeys(("lower", "upper", "velocity", "torque"), "the URDF's")
_OF_ENVELOPE = {
    "contact_force": "[contact.envelope] force, else inf",
    "contact_torque": "[contact.envelope] torque, else inf",
}

_TERM_TABLES = tables_by("use", PartTable, PACKAGED["term"], own=OwnPart)
_LIMIT_TABLES = tables_by("use", PartTable, PACKAGED["limit"], own=OwnPart)
_PATHS = tables_by(
    "curve",
    PathTable,
    {**CURVES, "points": CurvePlacement},
    opt.Path,
    bases={"points": PointsTable},
    omit=("times",),  # a key of `PointsTable`
    defaults={"free_axis": "none; with `faces` [0, 0, 1]"},
)
_OBSTACLES = tables_by("shape", ObstacleTable, SHAPES, opt.Obstacle)
_CONTACTS = tables_by("kind", ContactTable, {"rigid": None, "compliant": Grip}, Procedure)
_REFERENCES = tables_by("kind", ReferenceTable, {"plan": None, "re-planning": Replan})
_ATTITUDES = tables_by("law", DumpingTable, BASE_LAWS, bases={STATION_KEEPING: AttitudeTable})
_TABLES: dict[str, Any] = {
    "robot": table_of(load, base=RobotTable),
    "start": StartTable,
    "target": table_of(opt.Pose, base=TargetTable, omit=("reach",)),  # `reach` is a key of [plan]
    "also": list[table_of(opt.Pose, base=AlsoTable)],  # type: ignore[misc]  # a class made at import
    "via": list[table_of(opt.Waypoint, base=PlaceTable, defaults={"name": '"via 1", ...'})],  # type: ignore[misc]
    "path": union_of(_PATHS),
    "client": table_of(Client, base=ClientTable),
    "meet": table_of(opt.Meet, base=MeetTable),
    "contact": union_of(_CONTACTS),
    "plan": table_of(opt.Problem, default_terms, opt.SearchOptions, opt.Clearance, base=PlanTable),
    "term": list[union_of(_TERM_TABLES)],  # type: ignore[misc]
    "limit": list[union_of(_LIMIT_TABLES)],  # type: ignore[misc]
    "obstacle": list[union_of(_OBSTACLES)],  # type: ignore[misc]
    "limits": table_of(RobotLimits, defaults={**_OF_URDF, "acceleration": "1.25 /s times the rate limit"}),
    "control": union_of(tables_by("law", ControlTable, LAWS)),
    "reference": union_of(_REFERENCES),
    "simulation": table_of(
        simulation.Conditions, base=SimulationTable, defaults={"momentum": "[plan] momentum"}
    ),
    "plant": table_of(simulation.InertialError, base=PlantTable),
    "wheels": table_of(ReactionWheels),
    "thrusters": table_of(Thrusters),
    "attitude": union_of(_ATTITUDES),
    "friction": table_of(simulation.JointFriction),
    "actuator": table_of(simulation.Actuator),
    "sensors": table_of(simulation.Sensors),
    "wrist": table_of(simulation.WristSensor),
    "estimator": table_of(simulation.Estimator, base=EstimatorTable),
    "disturbance": list[table_of(simulation.Wrench)],  # type: ignore[misc]
    "capture": list[table_of(simulation.Capture)],  # type: ignore[misc]
    "fault": list[table_of(simulation.JointFault)],  # type: ignore[misc]
    "guards": table_of(simulation.Guards, base=GuardsTable, defaults=_OF_ENVELOPE),
    "learn": table_of(Identifier),
    "campaign": CampaignTable,
}
# Tables with required keys, which are reported as missing if the table is absent.
_REQUIRED = ("robot", "start")

ScenarioFile: type[Keys] = file_of(_TABLES, "ScenarioFile", required=_REQUIRED)
"""The tables of a scenario file by name."""
ScenarioFile.__doc__ = "A scenario: robot, task, plan, control, and the conditions of the closed loop."

# Tables whose absence differs from a table without keys.
NONE_IF_ABSENT = ("path", "client", "meet", "wheels", "thrusters", "attitude", "wrist", "learn")


def is_table(path: str) -> bool:
    """Return whether a key, such as "attitude.dump", is a table."""
    model: type[Keys] = ScenarioFile
    for step in path.split("."):
        field = model.model_fields.get(step)
        inner = [] if field is None else models_in(field.annotation)
        if not inner:
            return False
        model = inner[0]
    return True
