"""The conditions of a scenario's closed loop, as the objects that `simulate` takes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.control import (
    LAWS,
    BaseLaw,
    Coordinated,
    JointLaw,
    MomentumDump,
    QuaternionFeedback,
    StationKeeping,
)
from ffsms_pin.models import load
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.fits import COORDINATED_WITH, STATION_KEEPING
from ffsms_pin.scenarios.keys import DEGREES, radians
from ffsms_pin.simulation import (
    Actuator,
    Capture,
    Estimator,
    JointFault,
    JointFriction,
    Sensors,
    Watchdog,
    Wrench,
    perturb,
    random_plants,
)
from ffsms_pin.system import SpaceManipulator

__all__ = ["base_law", "control_steps", "controller", "loop_options"]

_CONTROL_STEP = 1e-3  # [s] `simulate`'s default


def loop_options(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> dict[str, Any]:
    """Keyword arguments of `simulate` for a plan that starts at q0 (nq,), but the reference and the law."""
    start = scenario.plant_start(sms, q0)
    simulation = scenario.simulation
    with scenario.named("plant"):
        simulated = _plant(scenario, sms)
    options: dict[str, Any] = {
        "dt": scenario.control.get("dt", _CONTROL_STEP),
        "q0": q0 if start is None else start,
        "plant": simulated,
        "integrator": simulation.get("integrator", "rk4"),
        "disturbances": tuple(Wrench(**one) for one in scenario.disturbance),
        "events": (
            *(Capture(**one) for one in scenario.capture),
            *(JointFault(**one) for one in scenario.fault),
        ),
    }
    if "v0" in simulation:
        options["v0"] = simulation["v0"]
    elif "momentum" in simulation or scenario.plan.get("mode", "floating") == "floating":
        # A plan with momentum is one for a plant that has it; one that holds the base says so itself.
        options["momentum"] = simulation.get("momentum", scenario.plan.get("momentum"))
        if options["momentum"] is None and scenario.meet is not None and scenario.meet.get("rest_after"):
            options["momentum"] = scenario.problem(sms, q0).momentum
    with scenario.named("attitude"):
        law = base_law(scenario.attitude, sms)
    if law is not None:
        options["base_controller"] = law
    if "wheel_momentum" in simulation:
        options["wheel_momentum"] = simulation["wheel_momentum"]
    made: dict[str, type] = {"friction": JointFriction, "actuator": Actuator, "sensors": Sensors}
    for name, kind in made.items():
        if given := getattr(scenario, name):
            options[name] = kind(**radians(given))
    if scenario.estimator:
        given = dict(scenario.estimator)
        on = given.pop("on", True)
        options["estimator"] = Estimator(**given) if on else False
    if scenario.watchdog is not None:
        limits = radians(scenario.watchdog)
        options["watchdog"] = Watchdog(**{key: limits[key] for key in limits if key != "path"})
    return options


def _plant(scenario: Scenario, sms: SpaceManipulator) -> SpaceManipulator:
    """What is simulated: the model, or a robot with other inertial parameters, or another robot."""
    given = dict(scenario.plant)
    simulated, shares = sms, given.pop("random", None)
    if "model" in given:
        path = scenario.robot_path(given.pop("model"))
        simulated = load(path, end_effector=given.pop("end_effector", sms.end_effector))
        simulated = simulated.with_actuators(wheels=sms.wheels, thrusters=sms.thrusters)
        if simulated.joint_names == sms.joint_names:  # `simulate` refuses another plant
            simulated = simulated.with_limits(sms.limits)
    if given:
        simulated = perturb(simulated, **given)
    if shares is not None:
        seed = np.random.default_rng(shares["seed"])
        ranges = {key: value for key, value in shares.items() if key != "seed"}
        (simulated,) = random_plants(simulated, seed, 1, **ranges)
    return simulated


def controller(scenario: Scenario, sms: SpaceManipulator, law: str | None = None) -> JointLaw:
    """A law of `LAWS`, by default the scenario's own, with the scenario's gains for it and torque limits."""
    law = scenario.law if law is None else law
    own = law == scenario.law
    others = ("law", "dt", "offset", "offset" + DEGREES, "torque_limit")
    gains = dict(scenario.control if own else scenario.laws.get(law, {}))
    gains = {key: value for key, value in gains.items() if key not in others}
    if law == "super-twisting":
        gains["dt"] = scenario.duration / control_steps(scenario)
    torque_limit = scenario.per_joint(sms, "control", "torque_limit")
    attitude = scenario.attitude or {}
    if law == COORDINATED_WITH and attitude.get("law") == "coordinated":
        return Coordinated(sms, torque_limit=torque_limit, **gains, **_base_options(attitude))
    return LAWS[law](sms, torque_limit=torque_limit, **gains)


def control_steps(scenario: Scenario) -> int:
    """How many control steps `simulate` makes: a whole number of them fills the run."""
    return max(1, round(scenario.duration / float(scenario.control.get("dt", _CONTROL_STEP))))


def base_law(attitude: Mapping[str, Any] | None, sms: SpaceManipulator) -> BaseLaw | None:
    """The law of the base that a scenario's [attitude] describes; None where the base is left to itself."""
    if attitude is None:
        return None
    options = _base_options(attitude)
    if attitude.get("law") == "coordinated":
        return Coordinated(sms, **options)
    if attitude.get("law") == STATION_KEEPING:
        return StationKeeping(sms, **options)
    return QuaternionFeedback(sms, **options)


def _base_options(attitude: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of the laws."""
    options = radians({key: value for key, value in attitude.items() if key not in ("law", "dump")})
    if "attitude" in options:
        options["attitude"] = pin.rpy.rpyToMatrix(np.array(options["attitude"]))
    if attitude.get("dump") is not None:
        options["dump"] = MomentumDump(**attitude["dump"])
    return options
