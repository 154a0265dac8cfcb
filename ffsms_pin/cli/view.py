"""`ffsms-pin view`: a results folder as an animated scene, in a file or in the browser."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ffsms_pin.cli.main import named
from ffsms_pin.cli.output import opened, say
from ffsms_pin.client import Client
from ffsms_pin.errors import FfsmsError, ResultError
from ffsms_pin.models import load
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.definition import load_scenario, read_json
from ffsms_pin.simulation import Tracking
from ffsms_pin.studies.client_motion import ClientMotion, client_motion
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer import View, view


def run(arguments: argparse.Namespace) -> int:
    """Write the scene, and open it unless a file was named."""
    folder = Path(arguments.results)
    show = None if arguments.show is None else [name.strip() for name in arguments.show.split(",")]
    how = named(arguments, "robot", "end_effector", "speed", "camera")
    scene = scene_of(folder, arguments.plan, show="all" if show == ["all"] else show, **how)
    out = folder / "view.html" if arguments.html is None else Path(arguments.html)
    scene.to_html(out)
    say(f"scene: {out}")
    if arguments.html is None:
        opened(out)
    return 0


def scene_of(
    folder: Path,
    plan_only: bool = False,
    robot: str | None = None,
    end_effector: str | None = None,
    show: str | Sequence[str] | None = None,
    **options: Any,
) -> View:
    """The scene of what `ffsms-pin run` wrote; `ResultError` where there is none, or another robot's.

    `plan_only` shows the plan, not the simulated motion. `robot` is one, or the scenario that names
    it, where the results cannot say; `end_effector` is its frame. `show` and `options` are those of `view`.
    """
    if not folder.is_dir():
        raise ResultError(folder, "is not a folder of results; make one with `ffsms-pin run`")
    if not (folder / "trajectory.npz").exists():
        raise ResultError(folder, "holds no results of `ffsms-pin run` (no trajectory.npz)")
    plan = Trajectory.load(folder / "trajectory.npz")
    told = folder / "summary.json"
    summary = read_json(told) if told.exists() else {}
    said, sms = _whose(folder, summary, robot, end_effector)
    _check(sms, plan, folder)
    result: Trajectory | Tracking = plan
    client: Client | ClientMotion | None = None
    if said is not None and said.client is not None:
        client = said.made_client(sms)
    if not plan_only and (folder / "tracking.npz").exists():
        result = tracking = Tracking.load(folder / "tracking.npz")
        if isinstance(client, Client) and (folder / "capture.npz").exists():
            result = tracking = Tracking.load(folder / "capture.npz")
            client = client_motion(tracking, client.shapes)
    around = [] if said is None else said.obstacles(client)
    title = str(summary.get("scenario", folder.name))
    return view(sms, result, plan, obstacles=around, client=client, show=show, title=title, **options)


def _whose(
    folder: Path, summary: dict[str, Any], robot: str | None, end_effector: str | None
) -> tuple[Scenario | None, SpaceManipulator]:
    """Scenario and robot of the results: what is named, what is kept beside them, or what is packaged."""
    said, name = None, summary.get("scenario")
    if robot is not None:
        if not robot.endswith(".toml") and robot not in scenario_names():
            return None, load(robot, end_effector=end_effector)
        said = scenario(robot)
    elif (folder / "scenario.json").exists():
        said = load_scenario(folder / "scenario.json")
    elif name in scenario_names():
        said = scenario(str(name))
    if said is not None:
        return said, said.load()
    if "robot" not in summary:
        raise ResultError(folder, "does not say whose motion it is (no summary.json): add --robot ROBOT")
    try:
        return None, load(str(summary["robot"]), end_effector=end_effector)
    except FfsmsError as error:
        raise ResultError(
            folder, f"its robot cannot be loaded: {error}; add --robot with it or with its scenario file"
        ) from None


def _check(sms: SpaceManipulator, plan: Trajectory, folder: Path) -> None:
    """Raise `ResultError` unless the robot's end effector is where the plan says."""
    if plan.q.shape[1] == sms.nq:
        tip = sms.at(plan.q[0]).end_effector_pose.translation
        if abs(tip - plan.end_effector[0]).max() < 1e-6:
            return
    raise ResultError(
        folder,
        f"is not a motion of '{sms.model.name}' with the end effector '{sms.end_effector}': "
        "add --robot with the robot, or with the scenario file of the run",
    )
