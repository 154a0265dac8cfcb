"""The function `view`, which makes an animated scene of a motion for a file or a notebook."""

from __future__ import annotations

import html
import os
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path as File
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.browser import open_in_browser
from ffsms_pin.capture import Flight
from ffsms_pin.checks import FloatArray, one_of, positive, vector
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import FfsmsWarning, InvalidValue
from ffsms_pin.files import path_like, write_content
from ffsms_pin.opt import Obstacle, Path, Trajectory
from ffsms_pin.opt.goals.goal import REACH
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios import Outcome
from ffsms_pin.scenarios.problems import grasp_of
from ffsms_pin.simulation import Phase, Tracking
from ffsms_pin.simulation.client_motion import client_motion
from ffsms_pin.viewer.environment import draw_events
from ffsms_pin.viewer.frames import (
    BACKGROUNDS,
    CAMERAS,
    DARK,
    FREE,
    DrawnClient,
    Frames,
    Result,
    Target,
    tips_at,
)
from ffsms_pin.viewer.marks import marks_of
from ffsms_pin.viewer.page import chosen_layers, facts, page, readings, staged
from ffsms_pin.viewer.robot import animate, draw_motion, moving_layers
from ffsms_pin.viewer.scene import Stage

_KAPPA = 10.0  # the paper's kappa, for a motion without a plan


def view(
    sms: SpaceManipulator | Result | Flight,
    result: Result | Flight | SpaceManipulator | None = None,
    plan: Trajectory | None = None,
    *,
    target: Target | None = None,
    obstacles: Sequence[Obstacle] = (),
    client: DrawnClient | None = None,
    grasp: Any = None,
    path: Path | None = None,
    events: Sequence[Phase] = (),
    show: str | Sequence[str] | None = None,
    camera: str = FREE,
    background: str = DARK,
    speed: float = 1.0,
    fps: float = 30.0,
    title: str | None = None,
    play: bool = True,
) -> View:
    """Make an animated scene of a motion, with the coupling drawn on the robot.

    `view(flight)` shows a capture with its client, obstacles and events. The first two arguments may be
    swapped.

    Parameters
    ----------
    sms : SpaceManipulator
        The robot of the motion; for a simulation with another plant, the plant. Default: the flight's plant.
    result : Trajectory, Tracking or capture.Flight
        The motion.
    plan : Trajectory, optional
        The plan of a `Tracking`. The planned path is drawn, and the plan's target, tolerance and kappa are
        used.
    target : array_like, shape (3,), or pinocchio.SE3, or callable, optional
        Target in inertial axes [m], or a function of time [s]. Default: the grasp on the client, else the
        plan's target unless the motion follows a path. Without a target, no direction and no cone are drawn.
    obstacles : sequence of Obstacle
        Obstacles of the plan. With `client`, obstacles on any client are drawn on `client`.
    client : Client or ClientMotion, optional
        Body to draw: an object with `shapes`, `pose(t)` and `poses(times)`, such as `ffsms_pin.Client`.
    grasp : array_like, shape (3,), or pinocchio.SE3, optional
        Grasp point in the client's axes [m]. Default: the flight's grasp.
    path : opt.Path, optional
        Path to follow, drawn in the frame to which it is fixed. Default: the plan's path.
    events : sequence of simulation.Phase
        Phases of a capture, which are marked in the scene and on the time bar of a `Tracking`. Default: the
        flight's phases. A stop of the run is always marked.
    show : str or sequence of str, optional
        Names of the layers in `LAYERS` that are visible at first, or "all". Default: all except "ghosts",
        "frames", "base_trail", "principal_motions", "limits" and "clearance". The legend of the page switches
        layers on and off.
    camera : str
        First view, a name in `CAMERAS`: "free" (oblique; motions in an x-y plane from above), "front" (from
        +x), "side" (from -y), "top" (from +z), or "base" (as "free", but moving with the base). The page has
        a control for the view.
    background : str
        "dark" or "white". The page has a control for the background.
    speed : float
        Playback speed: 1 is real time, 2 is twice as fast. The page has a control for the speed.
    fps : float
        Frame rate [1/s]; the page interpolates between frames. A scene has at most 1800 frames.
    title : str, optional
        Title of the page. Default: the name of the robot's model.
    play : bool
        True to start playing when the page opens.

    Returns
    -------
    View
        `to_html(path)` writes one file that any browser opens; a notebook shows the scene inline.

    Raises
    ------
    InvalidValue
        A value is out of range, or the result belongs to another robot.
    GeometryError
        The robot's shapes cannot be drawn.
    """
    if isinstance(result, SpaceManipulator) or isinstance(sms, Flight):
        sms, result = result, sms  # type: ignore[assignment]  # checked below
    if isinstance(result, Flight):
        flight, result = result, result.tracking
        sms = flight.plant if sms is None else sms
        plan = flight.plan if plan is None else plan
        client = client_motion(result, flight.client.shapes) if client is None else client
        obstacles = obstacles or flight.obstacles(client)
        events = events or flight.captured.phases
        grasp = flight.grasp if grasp is None else grasp
    if not isinstance(sms, SpaceManipulator):
        raise InvalidValue("sms", sms, "must be a SpaceManipulator")
    if not isinstance(result, Trajectory | Tracking):
        raise InvalidValue("result", result, "must be a Trajectory, a Tracking or a capture.Flight")
    speed, fps = positive("speed", speed), positive("fps", fps, "1/s")
    shown, camera = chosen_layers(show), one_of("camera", camera, CAMERAS)
    background = one_of("background", background, BACKGROUNDS)
    place = None if grasp is None else _grasp_place(grasp, client)
    aim = "target" if target is not None or place is None else "grasp"
    if client is not None and place is not None and target is None:
        target = _moving_place(client, place)
    planned = result if isinstance(result, Trajectory) else plan
    kappa, reach, planned_frames = _KAPPA, REACH, None
    path = _shown_path(path, planned, client)
    if planned is not None:
        kappa, reach = planned.kappa, planned.reach
        target = planned.target if target is None and path is None else target
        planned_frames = Frames.of(sms, planned, target, kappa, fps)
    frames = Frames.of(sms, result, target, kappa, fps)
    stage, cameras = staged(frames, camera, client, obstacles, path)
    draw_motion(stage, frames, planned_frames, result is not planned, client)
    marks = marks_of(result, events) if isinstance(result, Tracking) else []
    draw_events(stage, marks, tips_at(sms, result, [mark.time for mark in marks]))
    latched = next((mark.time for mark in marks if mark.name == "latched"), None)
    animate(stage, frames, moving_layers(stage, frames, reach, client, obstacles, place, latched, path))
    numbers = readings(frames, aim, latched, path)
    scene_facts = facts(
        stage, frames, shown, speed, play, marks, readings=numbers, background=background, **cameras
    )
    return View(frames, stage, scene_facts, title or sms.model.name)


def _shown_path(path: Path | None, planned: Trajectory | None, client: Any) -> Path | None:
    """Return the path to draw; a path on a client is moved from the plan's client to the drawn client."""
    if path is None and planned is not None and planned.problem is not None:
        path = planned.problem.goal if isinstance(planned.problem.goal, Path) else None
    if path is not None and isinstance(path.frame, FreeBody) and isinstance(client, FreeBody):
        return replace(path, frame=client)
    return path


def _grasp_place(grasp: Any, client: DrawnClient | None) -> FloatArray:
    """Return the grasp point (3,) in the client's axes [m]."""
    if client is None:
        raise InvalidValue("grasp", grasp, "requires client=..., the body on which the grasp is drawn")
    return vector("grasp", grasp.translation if isinstance(grasp, pin.SE3) else grasp, 3, "m")


def _moving_place(client: DrawnClient, place: FloatArray) -> Callable[[float], FloatArray]:
    """Return the position of a point (3,) on a client as a function of time [s], inertial axes [m]."""

    def at(t: float) -> FloatArray:
        positions, attitudes = client.poses(np.array([t]))
        return np.asarray(positions[0] + attitudes[0] @ place)

    return at


class View:
    """An animated scene, as returned by `view`."""

    def __init__(self, frames: Frames, stage: Stage, facts: dict[str, Any], title: str) -> None:
        self._frames, self._stage, self._facts, self._title = frames, stage, facts, title
        self.layers: dict[str, bool] = {layer["name"]: layer["shown"] for layer in facts["layers"]}
        """The scene's layers by name, True for a layer that is visible at first."""

    def to_html(self, path: str | os.PathLike[str]) -> None:
        """Write the scene atomically as one HTML file, which needs no other file and no network."""
        write_content(path, self.html())

    def open(self, path: str | os.PathLike[str] | None = None) -> File:
        """Write the HTML file, open it in the browser, and return its path.

        The page needs no server, so it stays open when a script ends. If there is no browser or no display, a
        warning (`FfsmsWarning`) names the file.

        Parameters
        ----------
        path : str or path, optional
            Path of the file. Default: a new temporary file.
        """
        if path is None:
            path = File(tempfile.mkdtemp(prefix="ffsms-pin-")) / "view.html"
        page_file = path_like("path", path).expanduser()
        self.to_html(page_file)
        if not open_in_browser(page_file):
            text = f"the scene is in {page_file}, but there is no browser or no display to open it"
            warnings.warn(text, FfsmsWarning, stacklevel=2)
        return page_file

    def html(self) -> str:
        """Return the text of the HTML file."""
        return page(self._title, self._stage.commands, self._facts)

    @property
    def duration(self) -> float:
        """The duration of the motion [s]."""
        return float(self._frames.t[-1] - self._frames.t[0])

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 480px; border: none"
        return f'<iframe srcdoc="{html.escape(self.html())}" style="{style}"></iframe>'


def view_capture(outcome: Outcome, **options: Any) -> View:
    """Make the scene of a scenario's outcome with a capture; `options` are other arguments of `view`.

    Raises
    ------
    InvalidValue
        The outcome has no capture.
    """
    capture = outcome.capture
    if capture is None:
        remedy = "must have a capture; use view(sms, tracking, plan) for other motions"
        raise InvalidValue("outcome", outcome.scenario.name, remedy)
    client = client_motion(capture.whole, capture.client.shapes)
    around = outcome.scenario.obstacles(client)
    scene: dict[str, Any] = {"obstacles": around, "client": client, "events": capture.phases}
    scene["grasp"] = grasp_of(outcome.scenario.meet or {})
    return view(outcome.plant, capture.whole, outcome.trajectory, **scene, **options)
