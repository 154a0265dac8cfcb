"""A results folder as a scene: the motion, its robot, and what the scenario put around it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ffsms_pin.client import Client
from ffsms_pin.errors import FfsmsError, ResultError
from ffsms_pin.models import load
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.capture import joined
from ffsms_pin.scenarios.client_motion import ClientMotion
from ffsms_pin.scenarios.definition import load_scenario
from ffsms_pin.simulation import Tracking
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer import View, view

__all__ = ["scene_of"]


def scene_of(
    folder: Path,
    plan_only: bool = False,
    robot: str | None = None,
    end_effector: str | None = None,
    show: str | Sequence[str] | None = None,
    **options: Any,
) -> View:
    """The scene of what `ffsms-pin run` wrote.

    Parameters
    ----------
    folder : Path
    plan_only : bool
        The plan as planned, not the simulated motion.
    robot : str, optional
        A robot, or the scenario that names it, where the results cannot say.
    end_effector : str, optional
        Frame, with `robot`.
    show
        Layers, as in `view`.
    options
        Others of `view`.

    Raises
    ------
    ResultError
        The folder holds no results, or those of another robot.
    """
    if not folder.is_dir():
        raise ResultError(folder, "is not a folder of results; make one with `ffsms-pin run`")
    if not (folder / "trajectory.npz").exists():
        raise ResultError(folder, "holds no results of `ffsms-pin run` (no trajectory.npz)")
    plan = Trajectory.load(folder / "trajectory.npz")
    summary = _summary(folder / "summary.json")
    said = _scenario(folder, summary, robot)
    sms = said.load() if said is not None else _robot(folder, summary, robot, end_effector)
    _check(sms, plan, folder)
    result: Trajectory | Tracking = plan
    client: Client | ClientMotion | None = None
    if said is not None and said.client is not None:
        client = said.made_client(sms)
    if not plan_only and (folder / "tracking.npz").exists():
        result = tracking = Tracking.load(folder / "tracking.npz")
        caught = [folder / name for name in ("capture.npz", "client.npz")]
        if isinstance(client, Client) and all(path.exists() for path in caught):
            client = ClientMotion.load(caught[1], client.shapes)
            result = joined(tracking, Tracking.load(caught[0]), client.held_from)
    around = [] if said is None else said.obstacles(client)
    title = str(summary.get("scenario", folder.name))
    return view(sms, result, plan, obstacles=around, client=client, show=show, title=title, **options)


def _summary(path: Path) -> dict[str, Any]:
    """What summary.json says; nothing where it is not there."""
    try:
        found = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ResultError(path, f"cannot be read ({error})") from None
    if not isinstance(found, dict):
        raise ResultError(path, "is not a summary of results")
    return found


def _scenario(folder: Path, summary: dict[str, Any], robot: str | None) -> Scenario | None:
    """The scenario of the results: the one that is named, the one kept beside them, or a packaged one."""
    if robot is not None:
        given = robot.endswith(".toml") or robot in scenario_names()
        return scenario(robot) if given else None
    if (folder / "scenario.json").exists():
        return load_scenario(folder / "scenario.json")
    name = summary.get("scenario")
    return scenario(str(name)) if name in scenario_names() else None


def _robot(
    folder: Path, summary: dict[str, Any], robot: str | None, end_effector: str | None
) -> SpaceManipulator:
    """The robot that the results belong to, where no scenario says it."""
    if robot is not None:
        return load(robot, end_effector=end_effector)
    if "robot" not in summary:
        raise ResultError(folder, "does not say whose motion it is (no summary.json): add --robot ROBOT")
    try:
        return load(str(summary["robot"]), end_effector=end_effector)
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
