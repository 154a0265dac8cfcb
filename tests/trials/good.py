"""Arguments that are right, by the name of the parameter: the trials spoil one or two of them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from motions import Swing

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation

__all__ = ["good_arguments", "planar", "things"]

STEPS = 5  # of a closed loop


def passing(t: float) -> list[float]:
    """The place of a target that moves."""
    return [0.9, 0.2 + 0.01 * t, 0.0]


# Parameters whose good value depends on what they belong to.
OF_ONE: dict[str, dict[str, Any]] = {
    "simulate": {"dt": 0.05 / STEPS},
    "simulate_many": {"dt": 0.05 / STEPS},
    "mount": {"base": None, "velocity": 0.5},
    "SatelliteBase": {"inertia": [10.0, 10.0, 10.0]},
    "Capture": {"inertia": [0.1, 0.1, 0.1]},
    "SuperTwisting": {"dt": 0.05 / STEPS},
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
    "StepWeights": {"effort": 1e-6},
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


def q0() -> Any:
    """A configuration within the limits."""
    return planar().configuration([0.3, 0.5, -0.4])


def things() -> dict[str, Any]:
    """Objects of the library whose methods are called: some remember, so each trial gets new ones."""
    sms = planar()
    state = sms.at(q0(), np.full(sms.nv, 0.1))
    laws = {name: law(sms) for name, law in control.LAWS.items()}
    made = {"sms": sms, "state": state, "coupling": state.coupling, "limits": sms.limits}
    goals = {
        "position": opt.Position([0.9, 0.2, 0.0]),
        "pose": opt.Pose(pin.SE3(np.eye(3), np.array([0.9, 0.2, 0.0]))),
        "moving": opt.Moving(passing),
    }
    planned = {"problem": problem(), "plan": short_plan(), "tracking": short_run()}
    return {**made, **goals, **laws, **planned}


def good_arguments(owner: str) -> dict[str, Any]:
    """Good values by the parameter's name, for the function or class `owner`."""
    sms = planar()
    common: dict[str, Any] = {
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
        "events": simulation.JointFault(0.02, 1), "watchdog": simulation.Watchdog(), "stream": "run.npz",
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
        "positions": [0.1, 0.2, 0.3], "seed": 1, "name_or_path": "case-1", "progress": lambda share: None,
        "failed_steps": 3, "side": [0.0, 0.0, 1.0],
    }  # fmt: skip
    return {**common, **OF_ONE.get(owner, {})}
