"""Call public functions of the library with one or two wrong arguments.

The functions must raise errors of the library for all wrong arguments: loading and mounting a robot, its
states, clients, problems, plans, the closed loop with every kind of condition, captures, and the readers of
files. Scenario files have separate trials.
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from motions import HASTY, Swing

import ffsms_pin as ffsms
from ffsms_pin import client, control, export, opt, simulation
from ffsms_pin.robot import SatelliteBase
from trials.judge import Trial
from trials.values import bad_value

__all__ = ["plan_by_steps", "run_of_steps", "trial"]

STEPS = 5  # number of steps of a closed loop
JOINTS = [0.3, 0.5, -0.4]
PLACE = [0.9, 0.2, 0.0]

# Conditions of a closed loop, by argument of `simulate`: the class and valid arguments of the class.
CONDITIONS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "friction": (simulation.JointFriction, {"viscous": 0.01, "coulomb": 0.01, "transition": 0.01}),
    "actuator": (simulation.Actuator, {"torque_limit": 1.0, "rate_limit": 10.0, "delay": 0.02}),
    "sensors": (simulation.Sensors, {"joint_noise": 1e-4, "base_latency": 0.02, "seed": 1}),
    "disturbances": (simulation.Wrench, {"wrench": [0.1] * 6, "on": "base", "start": 0.0, "end": 0.04}),
    "guards": (simulation.Guards, {"joint_error": 0.5, "failed_steps": 3, "path": "stopped.npz"}),
    "events": (
        simulation.Capture,
        {"time": 0.02, "mass": 2.0, "inertia": [0.1] * 3, "com": [0.1, 0.0, 0.0], "twist": [0.01] * 6},
    ),
    "estimator": (simulation.Estimator, {}),
}


def trial(seed: int) -> Trial:
    """Return the call of a seed."""
    rng = random.Random(f"call {seed}")
    name = rng.choice(sorted(_calls()))
    call, good = _calls()[name]
    arguments = _spoiled(rng, call, good)
    shown_arguments = ", ".join(f"{key}={_short(value)}" for key, value in arguments.items())
    return Trial(f"{name}({shown_arguments})", lambda: call(**arguments))


def _spoiled(rng: random.Random, call: Callable[..., Any], good: dict[str, Any]) -> dict[str, Any]:
    """Return arguments of which one or two are wrong; half of the optional arguments are omitted."""
    parameters = inspect.signature(call).parameters.values()
    named = [
        parameter
        for parameter in parameters
        if parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    ]
    wrong = rng.sample([parameter.name for parameter in named], k=min(len(named), rng.choice((1, 1, 1, 2))))
    arguments: dict[str, Any] = {}
    for parameter in named:
        needed = parameter.default is parameter.empty
        value = good.get(parameter.name, None if needed else parameter.default)
        if parameter.name in wrong:
            arguments[parameter.name] = bad_value(rng, value)
        elif needed or (parameter.name in good and rng.random() < 0.5):
            arguments[parameter.name] = value
    if arguments.get("progress") is int:  # errors of a custom function are passed on
        del arguments["progress"]
    return arguments


@cache
def _robot() -> ffsms.SpaceManipulator:
    return ffsms.load("planar_3r")


@cache
def _calls() -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Return the functions by name, each with valid arguments."""
    sms = _robot()
    q0, pose = sms.configuration(JOINTS), pin.SE3(np.eye(3), np.array(PLACE))
    body = client.Client(20.0, [1.0, 2.0, 2.5], pose, [0.01, 0.0, 0.0, 0.0, 0.0, 0.1])
    wheels = ffsms.ReactionWheels(np.eye(3), 0.01)
    thrusters = ffsms.Thrusters(np.eye(3), np.eye(3), 1.0, period=0.1)
    plan, run = plan_by_steps(), run_of_steps()
    plan.save("plan.npz")
    export.to_csv(sms, plan, "plan.csv")
    run.save("tracking.npz")
    limits = {"velocity": 0.5, "torque": 1.0, "acceleration": 0.5, "locked": {"joint_3": 0.1}}
    robot = {"end_effector": "end_effector", "base_size": [0.4, 0.4, 0.4], **limits}
    problem = {
        "sms": sms, "q0": q0, "goal": PLACE, "target": PLACE, "duration": 0.3, "dt": 0.1, "kappa": 10.0,
        "joint_rates": [0.01, 0.02, -0.01], "momentum": [1e-3] * 6, "locked": ("joint_3",), "effort": 1e-4,
        "terms": (opt.Coupling(), opt.Smooth()), "limits": (opt.JointLimits(), opt.Clearance()),
        "clearance": 0.01, "obstacles": (opt.Obstacle(coal.Box(0.1, 0.1, 0.1), pose),), "method": "step",
        "base_limits": opt.BaseLimits(attitude=0.5), "time_limit": 0.5, "via": [[0.8, 0.1, 0.0]],
        "also": {"link_2": opt.Position(PLACE)}, "problem": opt.Problem(sms, q0, PLACE, 0.3, 0.1),
        "options": HASTY, "base": 0.1, "tolerance": 0.1, "progress": lambda *_: None,
    }  # fmt: skip
    loop = {
        "sms": sms, "reference": _swing(), "controller": control.PD(sms), "dt": 0.05 / STEPS, "q0": q0,
        "plant": sms, "v0": np.zeros(9), "momentum": [1e-3] * 6, "substeps": 2, "client": body,
        "progress": lambda *_: None,
    }  # fmt: skip
    calls: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
        "load": (ffsms.load, {"robot": "planar_3r", **robot}),
        "mount": (ffsms.mount, {"arm": "planar_3r", "base": SatelliteBase(), "placement": pose, **robot}),
        "SatelliteBase": (
            SatelliteBase,
            {
                "mass": 50.0,
                "size": [1.0] * 3,
                "inertia": [10.0] * 3,
                "com": [0.1, 0.0, 0.0],
                "panels": (1.0, 0.5),
            },
        ),
        "SpaceManipulator": (ffsms.SpaceManipulator, {"model": sms.model, "limits": sms.limits, **robot}),
        "with_actuators": (sms.with_actuators, {"wheels": wheels, "thrusters": thrusters}),
        "configuration": (sms.configuration, {"joints": JOINTS, "base": pose}),
        "velocity": (sms.velocity, {"q": q0, "joint_rates": [0.01] * 3, "momentum": [1e-3] * 6}),
        "at": (_every_quantity, {"q": q0, "v": np.full(9, 0.1)}),
        "Client": (
            ffsms.Client,
            {
                "mass": 20.0,
                "inertia": [1.0] * 3,
                "pose": pose,
                "twist": [0.1] * 6,
                "shapes": [coal.Sphere(0.1)],
            },
        ),
        "Problem": (opt.Problem, problem),
        "plan": (opt.plan, problem),
        "solve": (opt.solve, problem),
        "step": (
            opt.StepPlanner(sms).step,
            {"q": q0, "joint_rates": [0.0] * 3, "target": PLACE, "time_left": 1.0},
        ),
        "simulate": (_loop, loop),
        "Trajectory.load": (opt.Trajectory.load, {"path": "plan.npz"}),
        "Tracking.load": (simulation.Tracking.load, {"path": "tracking.npz"}),
        "read_csv": (lambda path: export.read_csv(sms, path), {"path": "plan.csv"}),
    }
    for key, (kind, good) in CONDITIONS.items():
        calls[f"simulate with {kind.__name__}"] = _with_signature(partial(_loop_under, key, kind), kind), good
    return calls


@cache
def plan_by_steps() -> opt.Trajectory:
    """Return a plan of a few steps."""
    sms = _robot()
    return opt.plan(sms, sms.configuration(JOINTS), PLACE, duration=0.3, dt=0.1, method="step")


@cache
def run_of_steps() -> simulation.Tracking:
    """Return a recording of a few steps."""
    return ffsms.simulate(_robot(), _swing(), control.PD(_robot()), dt=0.05 / STEPS)


def _swing() -> Swing:
    return Swing(_robot(), displacement=(0.001, 0.002, -0.001), duration=0.05)


def _loop(**options: Any) -> simulation.Tracking:
    """Simulate; the signature has the fields of `Conditions` in place of `conditions`."""
    return ffsms.simulate(**options)


_loop.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
    [
        parameter.replace(kind=parameter.KEYWORD_ONLY)
        for function in (ffsms.simulate, ffsms.Conditions)
        for parameter in inspect.signature(function).parameters.values()
        if parameter.name != "conditions"
    ]
)


def _loop_under(key: str, kind: Callable[..., Any], **arguments: Any) -> Any:
    """Simulate a closed loop of a few steps under one condition."""
    condition: dict[str, Any] = {key: kind(**arguments)}
    return ffsms.simulate(_robot(), _swing(), control.PD(_robot()), dt=0.01, **condition)


def _with_signature(call: Any, other: Callable[..., Any]) -> Callable[..., Any]:
    call.__signature__ = inspect.signature(other)
    return call  # type: ignore[no-any-return]


def _every_quantity(q: Any, v: Any = None) -> None:
    state = _robot().at(q, v)
    # `at` accepts every finite velocity, so quantities may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        for name in dir(type(state)):
            if not name.startswith("_"):
                getattr(state, name)


def _short(value: Any) -> str:
    text = " ".join(repr(value).split()).encode("ascii", "backslashreplace").decode()
    return text if len(text) <= 60 else text[:57] + "..."
