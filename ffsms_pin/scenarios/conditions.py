"""The conditions of a scenario's closed loop, as the objects that `simulate` takes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.control import LAWS, JointLaw
from ffsms_pin.models import load
from ffsms_pin.scenarios.actuated import COORDINATED_WITH, base_law, coordinated
from ffsms_pin.scenarios.definition import Scenario
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

__all__ = ["control_steps", "controller", "loop_options", "plant"]

_CONTROL_STEP = 1e-3  # [s] `simulate`'s default


def loop_options(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> dict[str, Any]:
    """Keyword arguments of `simulate`: everything but the model, the reference and the controller.

    Parameters
    ----------
    scenario : Scenario
    sms : SpaceManipulator
        The model, as `scenario.load` gives it.
    q0 : ndarray, shape (nq,)
        Start of the plan.
    """
    start = scenario.plant_start(sms, q0)
    simulation = scenario.simulation
    options: dict[str, Any] = {
        "dt": scenario.control.get("dt", _CONTROL_STEP),
        "q0": q0 if start is None else start,
        "plant": plant(scenario, sms),
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
    if (law := base_law(scenario.attitude, sms)) is not None:
        options["base_controller"] = law
    if "wheel_momentum" in simulation:
        options["wheel_momentum"] = simulation["wheel_momentum"]
    if scenario.friction:
        options["friction"] = JointFriction(**radians(scenario.friction))
    if scenario.actuator:
        options["actuator"] = Actuator(**scenario.actuator)
    if scenario.sensors:
        options["sensors"] = Sensors(**radians(scenario.sensors))
    if scenario.estimator:
        given = dict(scenario.estimator)
        on = given.pop("on", True)
        options["estimator"] = Estimator(**given) if on else False
    if scenario.watchdog is not None:
        limits = radians(scenario.watchdog)
        options["watchdog"] = Watchdog(**{key: limits[key] for key in limits if key != "path"})
    return options


def plant(scenario: Scenario, sms: SpaceManipulator) -> SpaceManipulator:
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
    """A control law with the scenario's gains for it, and its torque limits.

    Parameters
    ----------
    scenario : Scenario
    sms : SpaceManipulator
    law : str, optional
        Of `ffsms_pin.control.LAWS`; default: the scenario's.
    """
    law = scenario.law if law is None else law
    own = law == scenario.law
    others = ("law", "dt", "offset", "offset" + DEGREES, "torque_limit")
    gains = dict(scenario.control if own else scenario.laws.get(law, {}))
    gains = {key: value for key, value in gains.items() if key not in others}
    if law == "super-twisting":
        gains["dt"] = scenario.duration / control_steps(scenario)
    torque_limit = scenario.per_joint(sms, "control", "torque_limit")
    both = coordinated(scenario.attitude, sms, torque_limit, gains) if law == COORDINATED_WITH else None
    return LAWS[law](sms, torque_limit=torque_limit, **gains) if both is None else both


def control_steps(scenario: Scenario) -> int:
    """How many control steps `simulate` makes: a whole number of them fills the run."""
    return max(1, round(scenario.duration / float(scenario.control.get("dt", _CONTROL_STEP))))
