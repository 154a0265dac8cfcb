"""Arguments that are right, by the name of the parameter: the trials spoil one or two of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from itertools import count
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from campaign_files import CAMPAIGN
from motions import Swing
from scenario_files import IN_RADIANS

import ffsms_pin as ffsms
from ffsms_pin import campaigns, client, control, engine, export, opt, scenarios, simulation

__all__ = ["good_arguments", "planar", "things"]

STEPS = 5  # of a closed loop
QUICK = f"""{IN_RADIANS}
[plan]
duration = 0.4
dt = 0.1
method = "step"
[control]
law = "pd"
dt = 0.02
"""
_numbers = count()


def passing(t: float) -> list[float]:
    """The place of a target that moves."""
    return [0.9, 0.2 + 0.01 * t, 0.0]


def rows_doubled(rows: range) -> dict[str, Any]:
    """Work of the engine."""
    return {"twice": 2 * np.array(rows)}


def sum_of(shared: int, task: int) -> int:
    """Work of the engine, one task at a time."""
    return shared + task


# Parameters whose good value depends on what they belong to.
OF_ONE: dict[str, dict[str, Any]] = {
    "simulate": {"dt": 0.05 / STEPS},
    "simulate_many": {"dt": 0.05 / STEPS},
    "mount": {"base": None, "velocity": 0.5},
    "SatelliteBase": {"inertia": [10.0, 10.0, 10.0]},
    "Capture": {"inertia": [0.1, 0.1, 0.1]},
    "reset": {"dt": None},
    "ideal_cosine": {"entropy": 0.5},
    "step_cost": {"entropy": 0.5},
    "plan_many": {"duration": 0.3, "target": [0.9, 0.2, 0.0]},
    "JointLimits": {"lower": [-1.0] * 3, "upper": [1.0] * 3, "velocity": [0.4] * 3, "torque": [1.0] * 3},
    "InertialError": {"base_inertia": 1.1, "arm_inertia": 1.1},
    "Wrench": {"end": 0.04},
    "Problem": {"limits": (opt.JointLimits(), opt.Clearance())},
    "Moving": {"path": passing},
    "Position": {"velocity": [0.01, 0.0, 0.0]},
    "BaseTurn": {"weight": 0.1},
    "Coupling": {"weight": 1.0},
    "Effort": {"weight": 1e-4},
    "Smooth": {"weight": 1e-5},
    "StepWeights": {"effort": 1e-6, "speed": 0.01},
    "Client": {"inertia": [1.0, 2.0, 2.5], "pose": pin.SE3.Identity(), "shapes": (coal.Box(0.4, 0.4, 0.4),)},
    "ReactionWheels": {"axes": np.eye(3), "inertia": 0.01, "torque": 0.1, "momentum": 1.0},
    "Thrusters": {"places": np.eye(3), "directions": np.eye(3), "force": 1.0, "period": 0.1},
    "Grip": {"grasp": pin.SE3.Identity(), "stiffness": 500.0, "damping": 50.0},
    "SurfaceContact": {
        "tool_shapes": [coal.Sphere(0.1)],
        "client_shapes": [coal.Box(1.0, 1.0, 1.0)],
        "stiffness": 1e5,
        "friction": 0.2,
        "damping": 20.0,
    },
    "probe_in_nozzle": {"place": pin.SE3.Identity()},
    "gripper_on_ring": {"place": pin.SE3.Identity()},
    "hertz_stiffness": {"radius": 0.1, "E": 7e10, "nu": 0.3},
    "of": {"samples": 8, "method": "sobol"},
    "measured": {"joints": np.zeros((2, 3)), "directions": np.eye(3)},
    "Batch": {"joints": np.zeros((2, 3))},
    "batch": {"joints": np.zeros((2, 3))},
    "wilson_interval": {"successes": 3, "runs": 5},
    "Chunks": {"rows": 5, "size": 2},
    "fitting": {"rows": 5},
    "file": {"index": 0},
    "sound": {"index": 0},
    "rows_of": {"index": 0},
    "scaled": {"rows": "all"},
    "all_results": {"count": 1},
    "Also": {"frame": "base", "goal": opt.Position([0.0, 0.0, 0.0])},
    "to_joint_trajectory": {"frame": "base"},
    "outcomes": {"work": sum_of, "tasks": [1, 2]},
    "open": {"specification": {"of": "a trial"}},
    "advance": {"rates": np.zeros(3)},
    "load": {"velocity": 0.5},
}


@cache
def planar() -> ffsms.SpaceManipulator:
    """The paper's planar system."""
    return ffsms.load("planar_3r")


@cache
def motion() -> Swing:
    """A joint motion of a twentieth of a second."""
    return Swing(planar(), way=(0.001, 0.002, -0.001), duration=0.05)


@cache
def short_plan() -> opt.Trajectory:
    """A plan of a few steps."""
    return opt.plan(planar(), q0(), [0.9, 0.2, 0.0], duration=0.3, dt=0.1, method="step")


@cache
def short_run() -> simulation.Tracking:
    """A recording of a few steps."""
    return ffsms.simulate(planar(), motion(), control.PD(planar()), dt=0.05 / STEPS)


def problem() -> opt.Problem:
    """What a plan of a few steps should do."""
    return opt.Problem(planar(), q0(), [0.9, 0.2, 0.0], 0.3, 0.1)


def place() -> Any:
    """A pose within reach."""
    return pin.SE3(np.eye(3), np.array([0.9, 0.2, 0.0]))


def thrusters() -> ffsms.Thrusters:
    """Three of them."""
    return ffsms.Thrusters(np.eye(3), np.eye(3), 1.0, period=0.1)


def q0() -> Any:
    """A configuration within the limits."""
    return planar().configuration([0.3, 0.5, -0.4])


@cache
def quick_scenario() -> scenarios.Scenario:
    """A scenario of a few steps."""
    path = Path("quick.toml").absolute()
    path.write_text(QUICK, encoding="utf-8")
    return scenarios.scenario(path)


@cache
def short_outcome() -> scenarios.Outcome:
    """It, planned and followed."""
    return scenarios.run(quick_scenario())


@cache
def two_runs() -> campaigns.Campaign:
    """A campaign of two runs."""
    path = Path("campaign.toml").absolute()
    path.write_text(CAMPAIGN, encoding="utf-8")
    return campaigns.Campaign.read(path, 2)


@cache
def finished_campaign() -> Path:
    """The folder of a campaign that is done, and its table."""
    folder = Path("finished").absolute()
    campaigns.campaign(two_runs(), folder, jobs=1)
    campaigns.merge(folder)
    return folder


def tumbling() -> client.Client:
    """A client that turns."""
    return client.Client(20.0, [1.0, 2.0, 2.5], place(), [0.01, 0.0, 0.0, 0.0, 0.0, 0.1])


def estimate() -> client.ClientEstimate:
    """What is known of it."""
    return client.ClientEstimate(tumbling(), 0.0, client.ClientSensor())


def captured() -> client.AfterCapture:
    """What it is once it is held."""
    return client.after_capture(planar(), q0(), np.full(planar().nv, 0.01), tumbling())


def things() -> dict[str, Callable[[], Any]]:
    """Makers of objects whose methods are called: some remember, so each trial gets new ones."""
    sms = planar()
    state = sms.at(q0(), np.full(sms.nv, 0.1))
    laws: dict[str, Callable[[], Any]] = {name: partial(law, sms) for name, law in control.LAWS.items()}
    made: dict[str, Callable[[], Any]] = {
        "sms": planar, "state": lambda: state, "coupling": lambda: state.coupling,
        "limits": lambda: sms.limits,
        "position": lambda: opt.Position([0.9, 0.2, 0.0]), "pose": lambda: opt.Pose(place()),
        "moving": lambda: opt.Moving(passing), "problem": problem, "plan": short_plan, "tracking": short_run,
        "client": tumbling, "estimate": estimate, "after": captured,
        "brake": lambda: client.brake(captured()),
        "campaign": two_runs, "folder": lambda: engine.ChunkFolder(finished_campaign()),
        "chunks": lambda: engine.Chunks(5, 2), "shard": lambda: engine.Shard(1, 2),
        "obstacle": lambda: opt.Obstacle(coal.Box(0.1, 0.1, 0.1), place()),
        "step planner": lambda: opt.StepPlanner(sms), "replanning": lambda: opt.Replanning(problem()),
        "view": lambda: ffsms.view(sms, short_plan()),
        "wheels": lambda: ffsms.ReactionWheels(np.eye(3), 0.01), "thrusters": thrusters,
        "pulses": lambda: control.PulseWidth(thrusters(), 0.01), "dump": control.MomentumDump,
    }  # fmt: skip
    return made | laws


def good_arguments(owner: str) -> dict[str, Any]:
    """Good values by the parameter's name, for the function or class `owner`."""
    return {**plain_arguments(), **_made(owner), **OF_ONE.get(owner, {})}


def _made(owner: str) -> dict[str, Any]:
    """Objects that take a while, made for who needs them, and names of files that are not there yet."""
    number = next(_numbers)
    if owner in ("merge", "report", "replayed_scenario", "runs_file"):
        return {"folder": finished_campaign(), "seed": 100}
    if owner == "read_csv":
        path = Path(owner).absolute()
        export.to_csv(planar(), short_plan(), path)
        return {"path": path}
    return {"folder": f"folder-{number}", "out": f"out-{number}"}


def plain_arguments() -> dict[str, Any]:
    """Those that mean the same wherever they stand."""
    sms = planar()
    return {
        "sms": sms, "model": sms.model, "end_effector": "end_effector", "base_size": [0.4, 0.4, 0.4],
        "base_box_placement": pin.SE3.Identity(), "acceleration": 0.5, "robot": "planar_3r",
        "arm": "planar_3r", "base": pin.SE3.Identity(), "placement": pin.SE3.Identity(), "locked": {},
        "package_dirs": [], "joints": [0.3, 0.5, -0.4], "joint_rates": np.array([0.01, 0.02, -0.01]),
        "q": q0(), "v": np.full(sms.nv, 0.01), "q_d": np.array([0.3, 0.5, -0.4]), "qd_d": np.zeros(3),
        "qdd_d": np.zeros(3), "momentum": np.full(6, 1e-3), "kind": "visual",
        "direction": [1.0, 0.0, 0.0], "mass": 10.0, "size": (1.0, 1.0, 1.0), "com": (0.01, 0.0, 0.0),
        "panels": None, "length": 1.0, "of": "attitude", "characteristic_length": 1.0,
        "point": [0.0, 0.0, 0.0], "tolerance": 1e-9, "reference": motion(), "controller": control.PD(sms),
        "plant": sms, "q0": q0(), "v0": np.zeros(sms.nv), "integrator": "rk4",
        "friction": simulation.JointFriction(0.01, 0.01), "actuator": simulation.Actuator(1.0),
        "estimator": simulation.Estimator(), "joint_acceleration": 5e-3, "base_acceleration": 5e-4,
        "base_angular_acceleration": 5e-4,
        "sensors": simulation.Sensors(joint_noise=1e-4), "disturbances": simulation.Wrench([0.1] * 6),
        "events": simulation.JointFault(0.02, 1), "watchdog": simulation.Watchdog(),
        "path": "result.npz", "target": [0.9, 0.2, 0.0], "duration": 0.3, "dt": 0.1, "kappa": 10.0,
        "clearance": 0.01, "collision": "points", "method": "step",
        "base_limits": opt.BaseLimits(attitude=0.5), "t": 0.05, "tasks": [],
        "goal": opt.Position([0.9, 0.2, 0.0]), "terms": (opt.Coupling(), opt.Smooth(), opt.Effort()),
        "problem": problem(), "options": opt.SearchOptions(time_limit=0.5), "time_limit": 0.5,
        "position": [0.9, 0.2, 0.0], "pose": pin.SE3(np.eye(3), np.array([0.9, 0.2, 0.0])),
        "reach": 0.02, "orientation_reach": 0.02, "attitude": 0.5, "attitude_rate": 0.5,
        "translation": 0.5, "final_attitude": 0.5, "effort": 1e-4, "cost_tolerance": 1e-3,
        "jobs": 1, "cos_theta": 0.3, "viscous": 0.01, "coulomb": 0.01, "transition": 0.01,
        "torque_limit": 1.0, "rate_limit": 10.0, "delay": 0.02, "time": 0.02, "twist": [0.0] * 6,
        "joint": 1, "told": True, "wrench": [0.1] * 6, "on": "base", "start": 0.0,
        "rng": np.random.default_rng(1), "count": 2, "error": simulation.InertialError(arm_mass=1.1),
        "positions": [0.1, 0.2, 0.3], "seed": 1, "name_or_path": "case-1", "progress": lambda *share: None,
        "failed_steps": 3, "side": [0.0, 0.0, 1.0],
        "wheels": ffsms.ReactionWheels(np.eye(3), 0.01), "thrusters": thrusters(), "client": tumbling(),
        "sensor": client.ClientSensor(), "first": tumbling(), "after": captured(),
        "samples": 8, "parameters": {"base_mass": [1.0, 1.1]}, "cells": 3, "shard": engine.Shard(1, 1),
        "number": 1, "found": iter([engine.Outcome(0, 1)]), "work": rows_doubled,
        "chunks": engine.Chunks(5, 2), "tables": [{"a": np.ones(2)}], "shared": 1,
        "specification": {"of": "a trial"}, "motion": short_run(), "plan": short_plan(),
        "trajectory": short_plan(), "tracking": short_run(), "flown": short_run(), "open_loop": short_run(),
        "result": short_run(), "runs": [short_run(), short_run()], "outcome": short_outcome(), "name": "plan",
        "scenario": quick_scenario(), "plants": 2, "state": q0(), "shape": coal.Box(0.1, 0.1, 0.1),
        "place": [0.8, 0.3, 0.0], "part": opt.Smooth(), "times": [0.0, 0.1], "text": "1/2", "index": 0,
        "sigma": [1.0, 0.5, 0.1], "n": 3, "C_bm": np.eye(6)[:, :3], "offset": np.zeros(3),
        "obstacles": (opt.Obstacle(coal.Box(0.1, 0.1, 0.1), place()),), "show": "all", "rows": range(2),
        "seen": tumbling(), "where": {"source": str(quick_scenario().source)}, "by": 0.1, "time_left": 0.2,
        "distance": 0.01, "velocity": np.zeros(9), "speed": np.zeros(3), "force": np.zeros(3),
        "rates": np.zeros((3, 3)), "inertia": [0.1, 0.1, 0.1], "value": np.ones((1, 3)), "srdf": "robot.srdf",
        "limits": sms.limits, "inertias": list(sms.model.inertias)[1:], "values": [1.0],
    }  # fmt: skip
