"""The planning problem of a scenario and its re-planning: goals, client, obstacles, terms and limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin import opt
from ffsms_pin.capture import (
    Belief,
    Camera,
    ClientEstimate,
    Grip,
    Nozzle,
    Planning,
    Replan,
    Ring,
    VisualReplanning,
)
from ffsms_pin.capture.rendezvous import Rendezvous, first_estimate
from ffsms_pin.checks import FloatArray, direction
from ffsms_pin.client import Client
from ffsms_pin.errors import InvalidScenario, ResultError
from ffsms_pin.identification import Identifier
from ffsms_pin.opt.goals.named_curves import CurvePlacement
from ffsms_pin.opt.goals.path_files import PathSamples, path_samples
from ffsms_pin.opt.plans import replannable
from ffsms_pin.opt.problem import default_limits, default_terms
from ffsms_pin.options.tables import options_of, radians
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import straight_end
from ffsms_pin.scenarios.own_parts import made_part
from ffsms_pin.scenarios.tables import CURVES, SHAPES
from ffsms_pin.simulation import Sensors
from ffsms_pin.system.dynamics import frame_pose
from ffsms_pin.system.mechanism import frame_index

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

Options = TypeVar("Options", bound=opt.ReplanOptions)
_REACHES = ("tolerance", "reach", "orientation_reach")  # keys of a goal's tolerances


def planning_problem(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray | None = None,
    dt: float | None = None,
    client: Client | ClientEstimate | None = None,
) -> opt.Problem:
    """Return the planning problem of a scenario: robot, start, goal, duration, terms and limits.

    Parameters
    ----------
    sms : SpaceManipulator
        The robot returned by `load`.
    q0 : ndarray, shape (nq,), optional
        Start configuration. Default: the start in the file.
    dt : float, optional
        Time step [s]. Default: `dt` of [plan].
    client : Client or ClientEstimate, optional
        The client for planning. Default: the first estimate of the client if [client] has a sensor, else the
        true client.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot, or a term or limit cannot be made.
    """
    if scenario.meet is not None:
        with scenario.named("plan", "meet", "start", "simulation"):
            return rendezvous(scenario, sms, q0).problem(client=client, dt=dt)
    plan, q0 = scenario.plan, scenario.start_configuration(sms) if q0 is None else q0
    with scenario.named("plan", *(["target"] if scenario.path is None else ["path"]), "start", "simulation"):
        if client is None and scenario.client is not None:
            client = seen_client(scenario, sms)
        if scenario.path is None:
            goal = _target({**scenario.target, **_only(plan, "reach")}, sms, q0)
        else:
            goal = _path_goal(scenario, sms, q0, client)
        options = scenario.options(opt.Problem, "plan") | parts(scenario, sms, q0, goal, client)
        return opt.Problem(sms, q0, goal, **(options if dt is None else {**options, "dt": dt}))


def parts(
    scenario: Scenario, sms: SpaceManipulator, q0: FloatArray, goal: opt.Goal, client: Any
) -> dict[str, Any]:
    """Return terms, limits, joint rates and wheel momenta of the problem, for a start q0 (nq,)."""
    holds = scenario.plan.get("mode") == "rotation-floating"
    others = [*_other_goals(scenario, sms, q0), *_waypoints(scenario, sms, q0)]
    return {
        "terms": terms(scenario, goal),
        "limits": [*limits(scenario, client), *others],
        "joint_rates": scenario.per_joint(sms, "start", "joint_rates"),
        "wheel_momentum": scenario.simulation.get("wheel_momentum") if holds else None,
    }


def terms(scenario: Scenario, goal: opt.Goal) -> list[opt.Term]:
    """Return the default terms, and the terms set by keys of [plan] and by [[term]]."""
    plan = scenario.plan
    coupled = goal.coupled or "kappa" in plan
    chosen = {key: plan[key] for key in ("kappa", "effort", "base") if key in plan}
    defaults = default_terms(**chosen, coupled=coupled)
    return _with_rows(scenario, "term", defaults)


def limits(scenario: Scenario, client: Any) -> list[opt.Limit]:
    """Return the default limits, with obstacles on `client`, and the limits of [plan] and [[limit]]."""
    limits = scenario.made(opt.BaseLimits, "plan.base_limits") if "base_limits" in scenario.plan else None
    defaults = default_limits(*scenario.clearance, scenario.obstacles(client), limits)
    return _with_rows(scenario, "limit", defaults)


def _with_rows(scenario: Scenario, kind: str, defaults: tuple[Any, ...]) -> list[Any]:
    """Return the defaults and the rows of [[kind]]; a row replaces the default of the same name."""
    ours = {part.name: part for part in defaults}
    more = [
        # The default clearance already has the values of this row, see `Scenario.clearance`.
        ours["clearance"] if row["use"] == "clearance" else made_part(scenario, kind, i, row)
        for i, row in enumerate(getattr(scenario, kind), start=1)
    ]
    names = [part.name for part in more]
    return [part for part in defaults if part.name not in names] + more


def _target(target: Mapping[str, Any], sms: SpaceManipulator, q0: FloatArray) -> opt.Goal:
    """Return the goal of the table [target], for a start q0 (nq,)."""
    values = radians(target)
    axes = _axes(values, sms, q0, sms.end_effector)
    place = _place(values, axes)

    def vector(key: str) -> FloatArray:
        return np.asarray(axes.rotation @ np.array(values.get(key, (0.0, 0.0, 0.0))))

    reaches = _only(values, *_REACHES)
    turned = isinstance(place, pin.SE3)
    velocity, spin = vector("velocity"), vector("spin")
    if velocity.any() or spin.any():
        start = place if turned else pin.SE3(np.eye(3), place)
        # The twist of a torque-free ball is constant.
        ball = Client(1.0, np.ones(3), start, np.append(velocity, spin))
        return opt.Moving(ball.pose if turned else lambda t: ball.pose(t).translation, **reaches)
    arrives = "arrival_velocity" in values
    if turned:
        twist = np.concatenate([vector("arrival_velocity"), vector("arrival_spin")]) if arrives else None
        return opt.Pose(place, twist, **reaches)
    return opt.Position(place, vector("arrival_velocity") if arrives else None, **reaches)


def _path_goal(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray, client: Any) -> opt.Path:
    """Return the goal of the table [path] for a motion from q0 (nq,), with the scenario's `client`."""
    values = radians(scenario.path)
    frame = values.get("frame", "inertial")
    options: dict[str, Any] = {"frame": client if frame == "client" else frame}
    if "faces" in values:
        options["free_axis"] = values.get("free_axis", CurvePlacement.tool_axis)
    with scenario.named("path"):
        place = {
            "axes": _placement(values, sms, q0, client),
            "attitude": pin.rpy.rpyToMatrix(np.array(values["attitude"])) if "attitude" in values else None,
            "tool_axis": direction("free_axis", values.get("free_axis", CurvePlacement.tool_axis)),
        }
        if values["curve"] == "points":
            points, attitudes, options["times"] = _samples(scenario, values)
            placed = scenario.made(CurvePlacement, "path", **place)
            turns = [None] * len(points) if attitudes is None else attitudes
            options["curve"] = list(map(placed.place, points, turns))
        else:
            options["curve"] = scenario.made(CURVES[values["curve"]], "path", **place)
        return scenario.made(opt.Path, "path", **options)


def _placement(values: Mapping[str, Any], sms: SpaceManipulator, q0: FloatArray, client: Any) -> Any:
    """Return the pose (pinocchio.SE3) of the curve's axes in the axes of the path's frame."""
    pose = _pose(values)
    if values.get("relative_to", "frame") == "frame":
        return pose
    tool, frame = sms.at(q0).end_effector_pose, values.get("frame", "inertial")
    if frame == "base":
        tool = pin.XYZQUATToSE3(q0[:7]).actInv(tool)
    elif frame == "client":
        tool = client.pose(0.0).actInv(tool)
    return tool * pose


def _samples(scenario: Scenario, values: Mapping[str, Any]) -> PathSamples:
    """Return the samples of a path from the table [path], or from the CSV file that it names."""
    if "file" not in values:
        return PathSamples(np.array(values["points"]), None, values.get("times"))
    file = f"[path] file = '{values['file']}'"
    try:
        samples = path_samples(scenario.source.parent / values["file"])
    except ResultError as error:
        raise InvalidScenario(scenario.source, f"{file} {error.problem}") from None
    for name in ("attitude", "faces"):
        if samples.attitudes is not None and name in values:
            message = f"has columns of attitudes, and [path] has the key '{name}', too; leave the key out"
            raise InvalidScenario(scenario.source, f"{file} {message}")
    return samples


def _other_goals(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> list[opt.FrameGoal]:
    """Return the goals of [[also]], which are for frames other than the end effector."""
    goals = []
    for i, values in enumerate(map(radians, scenario.also), start=1):
        frame = values["frame"]
        if frame == sms.end_effector:
            raise InvalidScenario(
                scenario.source, f"[[also]] {i} frame = '{frame}' is the end effector: use [target]"
            )
        with scenario.named(f"also.{i}"):
            place = _place(values, _axes(values, sms, q0, frame))
            kind: Any = opt.Pose if isinstance(place, pin.SE3) else opt.Position
            goals.append(opt.FrameGoal(frame, kind(place, **_only(values, *_REACHES))))
            goals[-1].for_robot(sms)  # raises if the robot has no such frame
    return goals


def _waypoints(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> list[opt.Waypoint]:
    """Return the waypoints of [[via]]; waypoints without a name are numbered."""
    waypoints = []
    for i, values in enumerate(map(radians, scenario.via), start=1):
        place = _place(values, _axes(values, sms, q0, sms.end_effector))
        name = values.get("name", f"via {i}")
        waypoints.append(scenario.made(opt.Waypoint, f"via.{i}", place=place, name=name))
    return waypoints


def bare_client(scenario: Scenario, sms: SpaceManipulator) -> Client:
    """Return the client without the nozzle or ring of [contact]; t = 0 is the start of the motion.

    If [client] has `joints`, its velocities are at the deadline. The grasp is then at the pose to which a
    smooth straight joint-space motion to these joint positions brings the end effector.
    """
    assert scenario.client is not None
    values = radians(scenario.client)
    twist = np.concatenate([values.get("velocity", np.zeros(3)), values.get("spin", np.zeros(3))])
    shapes = [coal.Box(*values["size"])] if "size" in values else []
    body = values["mass"], np.array(values["inertia"])
    with scenario.named("client"):
        if "position" in values:
            return Client(*body, _pose(values), twist, shapes)
        joints = scenario.per_joint(sms, "client", "joints")
        assert joints is not None  # [client] has position or joints
        duration, q0 = scenario.arrival, scenario.start_configuration(sms)
        end = sms.at(straight_end(sms, q0, joints, duration, scenario.plan.get("momentum")))
        then = Client(*body, end.end_effector_pose * grasp_of(scenario.meet or {}).inverse(), twist, shapes)
        return Client(*body, then.pose(-duration), then.twist(-duration), shapes)


def made_client(scenario: Scenario, sms: SpaceManipulator) -> Client:
    """Return the client of a scenario, with the shapes of a nozzle or ring of [contact]."""
    return bare_client(scenario, sms) if scenario.meet is None else rendezvous(scenario, sms).client


def seen_client(scenario: Scenario, sms: SpaceManipulator) -> Client | ClientEstimate:
    """Return the client for planning a path; with a sensor, the estimate after the first measurement."""
    client = bare_client(scenario, sms)
    if "sensor" not in (scenario.client or {}):
        return client
    return first_estimate(
        client, scenario.made(Camera, "client.sensor"), scenario.made(Belief, "client.belief")
    )


def rendezvous(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray | None = None) -> Rendezvous:
    """Return the rendezvous of a scenario from q0 (nq,), by default the start in the file."""
    q0 = scenario.start_configuration(sms) if q0 is None else q0
    contact, options, made = scenario.contact, scenario.options, scenario.made
    guides: dict[str, type[Nozzle | Ring]] = {"nozzle": Nozzle, "ring": Ring}
    with scenario.named("plan", "meet", "start", "simulation"):
        client = bare_client(scenario, sms)
        goal, sees = meeting(scenario.meet or {}, client), "sensor" in scenario.client
        search = opt.SearchOptions(**options(opt.SearchOptions, "plan"))
        return Rendezvous(
            sms,
            q0,
            goal,
            scenario.arrival,
            Planning(**options(Planning, "plan"), **parts(scenario, sms, q0, goal, client), search=search),
            made(Camera, "client.sensor") if sees else None,
            made(Belief, "client.belief") if sees else None,
            made(Grip, "contact") if contact.get("kind") == "compliant" else None,
            next((made(kind, f"contact.{name}") for name, kind in guides.items() if name in contact), None),
        )


def meeting(meet: Mapping[str, Any], client: Client | ClientEstimate) -> opt.Meet:
    """Return the goal of the table [meet] for a client."""
    others = {key: value for key, value in radians(meet).items() if key not in ("grasp", "grasp_rpy")}
    return opt.Meet(client, grasp_of(meet), **others)


def made_obstacles(scenario: Scenario, client: Any = None) -> list[opt.Obstacle]:
    """Return the obstacles; those fixed to the client only if `client` is not None.

    Paths of meshes are relative to the file's folder.
    """
    obstacles = []
    for i, row in enumerate(scenario.obstacle, start=1):
        on = row.get("on", "inertial")
        if on == "client" and client is None:
            continue
        made = SHAPES[row["shape"]]
        options = _only(row, *options_of(made), "margin", "name")
        if "file" in options:
            options["file"] = scenario.source.parent / options["file"]
        with scenario.named(f"obstacle.{i}"):
            obstacles.append(made(**options, at=_pose(radians(row)), on=client if on == "client" else on))
    return obstacles


def _only(values: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """Return the values of the named keys that are present."""
    return {key: values[key] for key in keys if key in values}


def grasp_of(meet: Mapping[str, Any]) -> Any:
    """Return the grasp (pinocchio.SE3) of the table [meet], in the client's axes."""
    values = radians(meet)
    return _pose({"position": values.get("grasp"), "rpy": values.get("grasp_rpy")})


def _pose(values: Mapping[str, Any]) -> Any:
    """Return the pose (pinocchio.SE3) of `position` [m] and `rpy` [rad], zero by default."""
    zero = (0.0, 0.0, 0.0)
    turn = pin.rpy.rpyToMatrix(np.array(values.get("rpy") or zero))
    return pin.SE3(turn, np.array(values.get("position") or zero))


def _place(values: Mapping[str, Any], axes: Any) -> Any:
    """Return the position (3,), or with `rpy` the pose (pinocchio.SE3), in inertial axes."""
    return axes * _pose(values) if "rpy" in values else np.asarray(axes.act(np.array(values["position"])))


def _axes(values: Mapping[str, Any], sms: SpaceManipulator, q0: FloatArray, frame: str) -> Any:
    """Return the inertial pose (pinocchio.SE3) of the axes named by `relative_to`, at q0 (nq,)."""
    which = values.get("relative_to", "inertial")
    if which == "inertial":
        return pin.SE3.Identity()
    if which == "base":
        return pin.XYZQUATToSE3(np.asarray(q0[:7]))
    return frame_pose(sms, q0, frame_index(sms.model, frame))


def replanning(
    scenario: Scenario, sms: SpaceManipulator, plan: opt.Trajectory | None = None
) -> opt.Replanning:
    """Return a reference that re-plans from the measured state; each run needs a new reference.

    If [client] has a sensor, the client is measured in the loop. Waypoints without a time get the time at
    which `plan` passes them, because the loop cannot detect passed waypoints.
    """
    if scenario.meet is not None:
        return rendezvous(scenario, sms).replanning(plan, replan_options(scenario, sms, Replan))
    reference, options = scenario.reference, replan_options(scenario, sms, opt.ReplanOptions)
    client = None if scenario.client is None else seen_client(scenario, sms)
    problem = replannable(scenario.problem(sms, dt=reference.get("dt"), client=client), plan)
    if isinstance(problem.goal, opt.Path) and problem.goal.timing == "fastest":  # keep the times of the plan
        if plan is None or plan.problem is None:
            problem = replace(problem, goal=replace(problem.goal, timing="given"))
        else:
            problem = replace(problem, goal=plan.problem.goal, duration=plan.duration)
    loop: dict[str, Any] = {"hold": reference.get("hold", 0.0), "plan": plan, "options": options}
    loop["learn"] = learner(scenario, sms)
    with scenario.named("reference"):
        if isinstance(client, ClientEstimate):
            return VisualReplanning(problem, bare_client(scenario, sms), client.sensor, client, **loop)
        return opt.Replanning(problem, **loop)


def replan_options(scenario: Scenario, sms: SpaceManipulator, kind: type[Options]) -> Options:
    """Return the options of re-planning in the table [reference]."""
    return scenario.made(kind, "reference", jerk=scenario.per_joint(sms, "reference", "jerk"))


def learner(scenario: Scenario, sms: SpaceManipulator) -> Identifier | None:
    """Return the identifier of [learn], with the noise of [sensors]; None if the file has no [learn]."""
    table = scenario.learn
    if table is None:
        return None
    with scenario.named("learn"):
        sensors = scenario.made(Sensors, "sensors") if scenario.sensors else None
        options = _only(table, "known", "spread", "at_rest")
        return Identifier(sms, list(table["unknown"]), sensors=sensors, **options)
