"""A scenario's closed loop: everything that acts in it made ready, and checked before anything is planned."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidScenario, InvalidValue, SimulationDiverged, SimulationStopped
from ffsms_pin.opt import Trajectory
from ffsms_pin.scenarios.conditions import loop_options
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.references import Held, replanning
from ffsms_pin.simulation import Controller, Reference, Tracking, simulate
from ffsms_pin.system import SpaceManipulator

__all__ = ["Attempt", "ClosedLoop", "attempt", "named", "prepared"]


class Attempt(NamedTuple):
    """A run that may have been stopped.

    Attributes
    ----------
    tracking : Tracking
        All of it, or what was recorded until it was stopped.
    stopped : str
        When and why; empty where it ran to its end.
    """

    tracking: Tracking
    stopped: str


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A scenario's conditions, ready for `simulate`.

    Attributes
    ----------
    scenario : Scenario
    sms : SpaceManipulator
    options : dict
        Keyword arguments of `simulate`.
    """

    scenario: Scenario
    sms: SpaceManipulator
    options: dict[str, Any]

    @property
    def plant(self) -> SpaceManipulator:
        """What is simulated."""
        plant: SpaceManipulator = self.options["plant"]
        return plant

    def reference(self, plan: Trajectory) -> Reference:
        """What is to be followed: the plan, or a new reference that plans again."""
        return replanning(self.scenario, self.sms, plan) if self.scenario.replans else self.plan_once(plan)

    def plan_once(self, plan: Trajectory) -> Reference:
        """The plan, and after its end the rest that it ends in for as long as the scenario holds."""
        hold = self.scenario.duration - self.scenario.arrival
        return Held(plan, hold) if hold > 0.0 else plan

    def run(
        self,
        reference: Reference,
        law: Controller,
        progress: Callable[[float], None] | None = None,
        **others: Any,
    ) -> Tracking:
        """Follow a reference under a law; `others` stand in for the scenario's options of `simulate`."""
        return simulate(self.sms, reference, law, progress=progress, **{**self.options, **others})


def prepared(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> ClosedLoop:
    """The closed loop of a scenario, whose plan starts at q0 (nq,).

    Raises
    ------
    InvalidValue
        A condition does not fit the robot or the motion.
    """
    loop = ClosedLoop(scenario, sms, loop_options(scenario, sms, q0))
    if scenario.replans:
        replanning(scenario, sms)
    # `simulate` looks at all it is given before the first control step: what cannot be used shows up now, and
    # not after the planning.
    with suppress(_Usable):
        loop.run(_Standstill(scenario, sms.joint_positions(q0)), _Probe())
    return loop


def attempt(run: Callable[[], Tracking]) -> Attempt:
    """A run to its end, or to where a watchdog or a state that is not finite stopped it."""
    try:
        return Attempt(run(), "")
    except (SimulationDiverged, SimulationStopped) as error:
        return Attempt(error.tracking, str(error))


@contextmanager
def named(scenario: Scenario) -> Iterator[None]:
    """Whatever value cannot be used inside the block is one of the scenario's file: errors name it."""
    try:
        yield
    except InvalidValue as error:
        raise InvalidScenario(scenario.source, str(error)) from None


class _Standstill:
    """A reference that stays: for checks."""

    def __init__(self, scenario: Scenario, positions: FloatArray) -> None:
        self.duration = scenario.duration
        self.target = scenario.target.get("position", (0.0, 0.0, 0.0))
        self._sample = positions, np.zeros_like(positions), np.zeros_like(positions)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self._sample


class _Usable(Exception):
    """Every condition was looked at."""


class _Probe:
    """A control law that ends a run at its first step."""

    def torque(
        self, q: FloatArray, v: FloatArray, q_d: FloatArray, qd_d: FloatArray, qdd_d: FloatArray
    ) -> FloatArray:
        raise _Usable
