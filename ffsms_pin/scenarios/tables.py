"""Tables of a scenario file: the options of the library, and keys of the file alone."""

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
from ffsms_pin.opt.problem import default_terms
from ffsms_pin.options import *
from ffsms_pin.robot import SatelliteBase, load
from ffsms_pin.scenarios.keys import *
from ffsms_pin.scenarios.paths import CURVES
from ffsms_pin.system import RobotLimits

DEFAULT_LAW, STATION_KEEPING = "sliding-mode", "station-keeping"  # the latter holds the base's place
BASE_LAWS: dict[str, Any] = {
    "quaternion": QuaternionFeedback,
    "coordinated": Coordinated,
    STATION_KEEPING: StationKeeping,
}
_Sensor: Any = table_of(Camera)
_Belief: Any = table_of(Belief)
_Envelope: Any = table_of(Envelope)
_Go: Any = table_of(GoLimits)
_Nozzle: Any = table_of(Nozzle)
_Ring: Any = table_of(Ring)
_BaseLimits: Any = table_of(opt.BaseLimits)
_Dump: Any = table_of(MomentumDump)
_OF_PLANT = "as [plant] has it"  # as large as what [plant.random] draws, and as what [plant] sets
_Masses: Any = table_of(MassUncertainty, defaults=dict.fromkeys(("arm", "base", "base_inertia"), _OF_PLANT))


class MountTable(Keys):
    """The table [robot.mount]: the satellite that an arm is mounted on."""

    position: Vector3 = key("m", "centre of the +x face")
    """where the arm's root link is in the base frame, the box's centre"""
    rpy: Vector3 = angle("rad", "[0, 1.5708, 0]")
    """its roll, pitch and yaw there. Default: the arm's z axis along the base's x"""


_Mount: Any = table_of(SatelliteBase, base=MountTable)


class RobotTable(Keys):
    """The table [robot]: the robot, by name or file."""

    model: Text = key("", "", required=True)
    """a robot that `ffsms_pin.load` knows, as `planar_3r` or `satellite_panda`, or a URDF's path from the
    file's folder"""
    mount: _Mount = table()


class StartTable(Keys):
    """The table [start]: the base is unturned, the system's centre of mass at the inertial origin."""

    joints: Numbers = angle("rad or m", "", "where the joints start, one each", required=True)
    joint_rates: PerJoint = angle("rad/s or m/s", "0")
    """how fast they move at the start, in the plan and in the closed loop; per joint"""


class PlaceTable(Keys):
    """A place of a frame of the robot."""

    position: Vector3 = key("m", "", "where the frame should be; the place stands still", required=True)
    rpy: Vector3 = angle("rad", "any attitude")
    """attitude of the frame there: roll, pitch and yaw, about the axes of `relative_to`"""
    relative_to: Literal["inertial", "base", "start"] = key("", '"inertial"')
    """what position and attitude are given in: "inertial" axes; the frame of the "base", or this frame itself
    ("start"), each where it is at the start of the motion. The place does not move with them"""


class TargetTable(PlaceTable):
    """The table [target]: the goal of the end effector."""

    position: Vector3 = key("m", "", "of the end effector")
    velocity: Vector3 = key("m/s", "0")
    """the target moves: it is at `position` at the start, and the end effector meets it at the deadline with
    this velocity"""
    spin: Vector3 = angle("rad/s", "0")
    """the target turns: its attitude is `rpy` at the start, and its angular velocity is this"""
    arrival_velocity: Vector3 = key("m/s", "0", "of the end effector at the deadline, at a target at rest")
    arrival_spin: Vector3 = angle("rad/s", "0")
    """its angular velocity then; needs `rpy` and `arrival_velocity`"""


class AlsoTable(PlaceTable):
    """The table [[also]]: the goal of another frame."""

    frame: Text = key("", "", "name of a frame of the robot: a link or a joint", required=True)


class PathTable(Keys):
    """The table [path]: a curve that the end effector follows."""

    curve: Annotated[str, OneOf(tuple(CURVES))] = key("", "", required=True)
    """"line": from the origin of its axes to `end`; "circle": about their z axis, from their x axis on;
    "helix": a circle that rises along z, by as much below the origin as above; "rounded-square": about their
    z axis, from the middle of the side at +x on; "points": splines through `points`"""
    frame: Literal["inertial", "base", "client"] = key("", '"inertial"')
    """what the curve is fixed to, as `opt.Path` has it"""
    position: Vector3 = key("m", "0", "the origin of the curve's axes in those of `frame`")
    rpy: Vector3 = angle("rad", "0", "and their roll, pitch and yaw")
    relative_to: Literal["frame", "start"] = key("", '"frame"')
    """"start": `position` and `rpy` count from the end effector at the start of the motion"""
    end: Vector3 = key("m", "", "of a line")
    radius: Positive = key("m", "", "of a circle or a helix")
    rise: Number = key("m", "", "of a helix: from its first point to its last one, along z")
    turns: Number = key("", "1", "of a circle or a helix; below zero the other way round")
    side: Positive = key("m", "", "of a rounded square")
    corner: Positive = key("m", "", "the radius of its corners")
    points: Rows = key("m", "", "positions, in the curve's axes")
    file: Text = key("", "")
    """in place of `points` and `times`: a CSV file, a path from this file's folder, with columns x, y, z [m]
    and, if they are wanted, t [s] and an attitude qx, qy, qz, qw, named in its first line"""
    attitude: Vector3 = angle("rad", "any", "of the end effector, in the curve's axes: roll, pitch and yaw")
    faces: Literal["axis", "centre"] = key("", "nothing")
    """where `free_axis` points: to the z axis of the curve's axes, or to their origin"""


class ClientTable(Keys):
    """The table [client]: a free rigid body that is met and captured, or looked at along a [path]."""

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


class MeetTable(Keys):
    """The table [meet]: how the end effector meets the client."""

    grasp: Vector3 = key("m", "0", "place of the grasp frame in the client's axes, from its centre of mass")
    grasp_rpy: Vector3 = angle("rad", "0", "its roll, pitch and yaw against the client's axes")


class ContactTable(Keys):
    """The table [contact]: what happens at the contact with the client, and after it."""

    kind: Literal["rigid", "compliant"] = key("", '"rigid"')
    """a weld at once; "compliant": a spring and a damper for a while, then a weld"""
    envelope: _Envelope = table()
    go: _Go = table()
    masses: _Masses = table()
    nozzle: _Nozzle = table()
    ring: _Ring = table()


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


class PlanTable(Keys):
    """The table [plan]: options of the plan."""

    method: Annotated[str, OneOf(opt.METHODS)] = key("", '"horizon"')
    """one of `opt.METHODS`; the others are there for comparison"""
    reach: Positive = key("m", "0.02")
    """the paper's r_th. A plan that is within it from 0.9 T on has reached; a closed loop that ends within it
    has arrived"""
    base_limits: _BaseLimits = table()


class ControlTable(Keys):
    """The table [control]: the joints' law and its gains."""

    law: Annotated[str, OneOf(tuple(LAWS))] = key("", f'"{DEFAULT_LAW}"')
    """"sliding-mode" (the paper's), "computed-torque", "pd", "impedance" or "admittance"; the last two are in
    [contact](contact.md)"""
    torque_limit: PerJointLimit = key("N m or N", "[limits] torque", "cut off there; per joint, may be inf")
    dt: Positive = key("s", "0.001", "control and integration step; the torque is held for it")
    offset: PerJoint = angle("rad or m", "0")
    """how far from the plan's start the simulated arm starts; per joint"""


class AttitudeTable(Keys):
    """The table [attitude]: the law of the base."""

    law: Annotated[str, OneOf(tuple(BASE_LAWS))] = key("", '"quaternion"')
    """"quaternion": feedback, beside any law of [control]; "coordinated": arm and base by one model, with
    `law = "computed-torque"` and its gains under [control]; "station-keeping": thrusters hold the base's
    place too"""
    attitude: Vector3 = angle("rad", "that at the start", "roll, pitch, yaw of the root frame to hold")
    dump: _Dump = table()


class ReferenceTable(Keys):
    """The table [reference]: what the closed loop follows."""

    kind: Literal["plan", "re-planning"] = key("", '"plan"')
    """"plan": the plan made once; "re-planning": the motion is planned anew from the measured state, as by
    `opt.Replanning`. The plan made once is then simulated beside it"""
    hold: NotNegative = key("s", "0", "how long to stay at the target after the arrival")


class SimulationTable(Keys):
    """The table [simulation]: the plant's start, and its integration."""

    q0: Numbers = key("", "the plan's start")
    """configuration at the start (nq numbers), Pinocchio's: base position, quaternion (x, y, z, w), joints"""


class RandomPlantTable(Keys):
    """The table [plant.random]: a plant that is drawn round that of [plant]."""

    seed: Whole = key("", "", "of the draw: the same seed, the same plant", required=True)


_Random: Any = table_of(simulation.random_plants, base=RandomPlantTable)


class PlantTable(Keys):
    """The table [plant]: the robot that is simulated, where it is another one than the model."""

    model: Text = key("", "the model", "another robot with the same joints, as under [robot]")
    end_effector: Text = key("", "the model's", "its frame; needs `model`")
    random: _Random = table()


class EstimatorTable(Keys):
    """The table [estimator]: the filter of the measurements."""

    on: bool = key("", "true", "false: the measurements are shown as they are")


class GuardsTable(Keys):
    """The table [guards]: limits of the flight."""

    on: bool = key("", "true", "false: no guards; only a state that is not finite ends the run")


class CampaignTable(Keys):
    """The table [campaign]: the draws of `ffsms-pin campaign`; a single run does not use it."""

    seed: Whole = key("", "1", "of the first run; the others follow")
    draw: dict[str, Any] = key("", "")
    """a table: distributions by key of this file, as `plant.arm_mass = { uniform = [0.8, 1.2] }`"""


OWN = "package.module:Class"


class OwnPart(Keys):
    """A class of the user's own; the other keys are its keyword arguments."""

    model_config = ConfigDict(extra="allow")

    use: Annotated[Text, WithJsonSchema({"type": "string", "pattern": ":"})] = key(
        "", "", f'a class of your own, as "{OWN}"', required=True
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
    kind: {made.name.replace(" ", "-"): made for made in rows}
    for kind, rows in {"term": _TERMS, "limit": _LIMITS}.items()
}
"""The library's own terms and limits by their names in a scenario file."""


PARTS: Mapping[str, Mapping[str, type[Keys]]] = part_tables(PACKAGED, own=OwnPart)
"""The tables [[term]] and [[limit]] by their `use`; "own" is a class of the user's."""


_OF_URDF = dict.fromkeys(("lower", "upper", "velocity", "torque"), "the URDF's")
_OF_ENVELOPE = {f"contact_{name}": f"[contact.envelope] {name}, else inf" for name in ("force", "torque")}

_TABLES: dict[str, Any] = {
    "robot": table_of(load, base=RobotTable),
    "start": StartTable,
    "target": table_of(opt.Pose, base=TargetTable, omit=("reach",)),  # [plan] has the reach
    "also": list[table_of(opt.Pose, base=AlsoTable)],  # type: ignore[misc]  # made here
    "via": list[table_of(opt.Waypoint, base=PlaceTable, defaults={"name": '"via 1", ...'})],  # type: ignore[misc]
    "path": table_of(opt.Path, base=PathTable, defaults={"free_axis": "none; with `faces` [0, 0, 1]"}),
    "client": table_of(Client, base=ClientTable),
    "meet": table_of(opt.Meet, base=MeetTable),
    "contact": table_of(Grip, Procedure, base=ContactTable),
    "plan": table_of(opt.Problem, default_terms, opt.SearchOptions, opt.Clearance, base=PlanTable),
    "term": list[any_of(PARTS["term"])],  # type: ignore[misc]
    "limit": list[any_of(PARTS["limit"])],  # type: ignore[misc]
    "obstacle": list[table_of(opt.Obstacle, base=ObstacleTable)],  # type: ignore[misc]
    "limits": table_of(RobotLimits, defaults={**_OF_URDF, "acceleration": "1.25 /s times the rate limit"}),
    "control": table_by(LAWS, base=ControlTable),
    "reference": table_of(Replan, base=ReferenceTable),
    "simulation": table_of(
        simulation.Conditions, base=SimulationTable, defaults={"momentum": "[plan] momentum"}
    ),
    "plant": table_of(simulation.InertialError, base=PlantTable),
    "wheels": table_of(ReactionWheels),
    "thrusters": table_of(Thrusters),
    "attitude": table_by(BASE_LAWS, base=AttitudeTable),
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
_REQUIRED = ("robot", "start")  # with keys that must be there, so that an absent table is missing these

ScenarioFile: type[Keys] = file_of(_TABLES, "ScenarioFile", required=_REQUIRED)
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
