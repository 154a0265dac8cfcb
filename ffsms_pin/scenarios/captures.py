"""The conversion of a scenario with a client into the arguments of `capture.fly`."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from inspect import signature
from typing import Any

import numpy as np

from ffsms_pin import opt
from ffsms_pin.capture import (
    Belief,
    Camera,
    Control,
    Envelope,
    Flight,
    GoLimits,
    Grip,
    MassUncertainty,
    Planning,
    Procedure,
    Replan,
    fly,
)
from ffsms_pin.capture.rendezvous import Rendezvous
from ffsms_pin.checks import FloatArray
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.closed_loop import ClosedLoop, base_law, controller
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.problems import bare_client, guide_of, meeting, parts
from ffsms_pin.simulation import random_plants


def rendezvous(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray | None = None) -> Rendezvous:
    """Return the rendezvous of a scenario from q0 (nq,), by default the start in the file."""
    q0 = scenario.start_configuration(sms) if q0 is None else q0
    with scenario.named("plan", "meet", "start", "simulation"):
        return Rendezvous(sms, q0, **_encounter(scenario, sms, q0))


def fly_scenario(
    loop: ClosedLoop,
    plan: opt.Trajectory,
    progress: Callable[[float], None] | None,
    once: bool,
) -> Flight:
    """Fly a scenario's capture by `capture.fly`; see `flown` for the parameters."""
    scenario, sms = loop.scenario, loop.sms
    q0 = scenario.start_configuration(sms)
    return fly(
        sms,
        q0,
        **_encounter(scenario, sms, q0),
        envelope=scenario.made(Envelope, "contact.envelope"),
        control=Control(
            partial(controller, scenario),
            None if scenario.attitude is None else partial(base_law, scenario.attitude),
            loop.options["dt"],
        ),
        plant=loop.plant,
        plant_q0=loop.options["q0"],
        conditions=loop.options["conditions"],
        replan=replan(scenario, sms) if scenario.replans and not once else False,
        procedure=scenario.made(
            Procedure,
            "contact",
            go=scenario.made(GoLimits, "contact.go"),
            masses=MassUncertainty(**_mass_deviations(scenario)),
        ),
        plan=plan,
        progress=progress,
    )


def replan(scenario: Scenario, sms: SpaceManipulator) -> Replan:
    """Return the options of re-planning in the table [reference]."""
    return scenario.made(Replan, "reference", jerk=scenario.per_joint(sms, "reference", "jerk"))


def _encounter(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> dict[str, Any]:
    """Return the arguments that `Rendezvous` and `fly` share."""
    assert scenario.client is not None
    client, contact = bare_client(scenario, sms), scenario.contact
    goal, grip, camera, belief = meeting(scenario.meet or {}, client), None, None, None
    if contact.get("kind") == "compliant":
        grip = scenario.made(Grip, "contact")
    if "sensor" in scenario.client:
        camera, belief = scenario.made(Camera, "client.sensor"), scenario.made(Belief, "client.belief")
    planning = Planning(
        **scenario.options(Planning, "plan"),
        **parts(scenario, sms, q0, goal, client),
        search=opt.SearchOptions(**scenario.options(opt.SearchOptions, "plan")),
    )
    return {
        "goal": goal,
        "duration": scenario.arrival,
        "planning": planning,
        "camera": camera,
        "belief": belief,
        "grip": grip,
        "guide": guide_of(scenario),
    }


def _mass_deviations(scenario: Scenario) -> dict[str, float]:
    """Return the deviations of the servicer's masses in [contact.masses]; default: those of [plant]."""
    plant, drawn, defaults = scenario.plant, scenario.plant.get("random"), signature(random_plants).parameters
    base = plant.get("base_mass", 1.0)
    factors = {
        "arm_mass": plant.get("arm_mass", 1.0),
        "base_mass": base,
        "base_inertia": plant.get("base_inertia", base),
    }
    deviations = {}
    for key, factor in factors.items():
        share = 0.0 if drawn is None else drawn.get(key, defaults[key].default)
        drawn_deviation = share / math.sqrt(3.0)  # of a uniform distribution between -share and share
        bias = float(np.abs(np.asarray(factor) - 1.0).max())
        deviations[key.removesuffix("_mass")] = math.hypot(drawn_deviation, bias)
    return deviations | dict(scenario.contact.get("masses", {}))
