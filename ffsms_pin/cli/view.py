"""The command `ffsms-pin view`: a results folder as an animated scene in a file or the browser."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ffsms_pin.browser import open_in_browser
from ffsms_pin.cli.main import named
from ffsms_pin.cli.output import say
from ffsms_pin.client import Client
from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError
from ffsms_pin.files import read_json
from ffsms_pin.opt import Trajectory
from ffsms_pin.robot import SpaceManipulator, load
from ffsms_pin.scenarios import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.definition import load_scenario
from ffsms_pin.scenarios.problems import grasp_of
from ffsms_pin.simulation import Phase, Tracking
from ffsms_pin.simulation.client_motion import ClientMotion, client_motion
from ffsms_pin.viewer import View, view


def run(arguments: argparse.Namespace) -> int:
    """Write the scene, and open it unless --html is given."""
    folder, robot = Path(arguments.results), arguments.robot
    if arguments.end_effector is not None and (robot is None or _is_scenario(robot)):
        remedy = "requires a robot in --robot; a scenario sets [robot] end_effector in its file"
        raise InvalidValue("--end-effector", arguments.end_effector, remedy)
    show = None if arguments.show is None else [name.strip() for name in arguments.show.split(",")]
    how = named(arguments, "robot", "end_effector", "speed", "camera", "background")
    scene = scene_of(folder, arguments.plan, show="all" if show == ["all"] else show, **how)
    out = folder / "view.html" if arguments.html is None else Path(arguments.html)
    scene.to_html(out)
    say(f"scene: {out}")
    if arguments.html is None:
        open_in_browser(out)
    return 0


def scene_of(
    folder: Path,
    plan_only: bool = False,
    robot: str | None = None,
    end_effector: str | None = None,
    show: str | Sequence[str] | None = None,
    **options: Any,
) -> View:
    """Return the scene of the results of `ffsms-pin run`.

    With `plan_only`, the scene shows the plan, not the simulated motion. `robot` names the robot or its
    scenario; by default the robot is taken from the results. `end_effector` is the end-effector frame of a
    robot in `robot`, unused for a scenario. `show` and `options` are arguments of `viewer.view`.
    `ResultError` is raised if the folder has no results, if the robot of the results cannot be determined, or
    if the results are of another robot.
    """
    if not folder.is_dir():
        raise ResultError(folder, "is not a folder of results; make one with `ffsms-pin run`")
    if not (folder / "trajectory.npz").exists():
        raise ResultError(folder, "holds no results of `ffsms-pin run` (no trajectory.npz)")
    plan = Trajectory.load(folder / "trajectory.npz")
    summary_file = folder / "summary.json"
    summary = read_json(summary_file) if summary_file.exists() else {}
    chosen, sms = _robot_of(folder, summary, robot, end_effector)
    _check(sms, plan, folder)
    result: Trajectory | Tracking = plan
    client: Client | ClientMotion | None = None
    if chosen is not None and chosen.client is not None:
        client = chosen.made_client(sms)
    if not plan_only and (folder / "tracking.npz").exists():
        result = tracking = Tracking.load(folder / "tracking.npz")
        if isinstance(client, Client) and (folder / "capture.npz").exists():
            result = tracking = Tracking.load(folder / "capture.npz")
            client = client_motion(tracking, client.shapes)
    obstacles = [] if chosen is None else chosen.obstacles(client)
    grasp = None if chosen is None or chosen.meet is None else grasp_of(chosen.meet)
    phases = () if result is plan else summary.get("capture", {}).get("phases", ())
    events = [Phase(phase["t_s"], phase["name"], phase["reason"]) for phase in phases]
    title = str(summary.get("scenario", folder.name))
    scene: dict[str, Any] = {"obstacles": obstacles, "client": client, "grasp": grasp, "events": events}
    if chosen is not None and chosen.path is not None:
        # The curve does not depend on terms and limits, which may need code of the user.
        plain = replace(chosen, tables={**chosen.tables, "term": (), "limit": ()})
        scene["path"] = replace(plain.problem(sms).goal, duration=plan.duration)
    return view(sms, result, plan, show=show, title=title, **scene, **options)


def _robot_of(
    folder: Path, summary: dict[str, Any], robot: str | None, end_effector: str | None
) -> tuple[Scenario | None, SpaceManipulator]:
    """Return scenario (or None) and robot from `robot`, the saved scenario, or the summary, in this order."""
    chosen, name = None, summary.get("scenario")
    if robot is not None:
        if not _is_scenario(robot):
            return None, load(robot, end_effector=end_effector)
        chosen = scenario(robot)
    elif (folder / "scenario.json").exists():
        chosen = load_scenario(folder / "scenario.json")
    elif name in scenario_names():
        chosen = scenario(str(name))
    if chosen is not None:
        return chosen, chosen.load()
    if "robot" not in summary:
        raise ResultError(folder, "has no summary.json with the robot's name; add --robot ROBOT")
    try:
        return None, load(str(summary["robot"]))
    except FfsmsError as error:
        raise ResultError(
            folder, f"its robot cannot be loaded: {error}; add --robot with the robot or its scenario file"
        ) from None


def _is_scenario(robot: str) -> bool:
    return robot.endswith(".toml") or robot in scenario_names()


def _check(sms: SpaceManipulator, plan: Trajectory, folder: Path) -> None:
    """Raise `ResultError` unless the robot has the plan's end-effector position at the start."""
    if plan.q.shape[1] == sms.nq:
        tip = sms.at(plan.q[0]).end_effector_pose.translation
        if abs(tip - plan.end_effector[0]).max() < 1e-6:
            return
    raise ResultError(
        folder,
        f"is not a motion of '{sms.model.name}' with the end effector '{sms.end_effector}': "
        "choose the run's robot with --robot and --end-effector, or its scenario file with --robot",
    )
