"""A scenario's closed loop: what it follows, and what acts in it, checked before anything is planned."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate, ClientSensor, measured
from ffsms_pin.errors import SimulationDiverged, SimulationStopped
from ffsms_pin.opt import AlphaBox, Problem, Replanning, ReplanOptions, SearchOptions, Trajectory, Via
from ffsms_pin.opt.planning.plan import plan_problem
from ffsms_pin.scenarios.conditions import loop_options
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.task import sensor
from ffsms_pin.simulation import Controller, Reference, Tracking, simulate
from ffsms_pin.system import SpaceManipulator

__all__ = ["Attempt", "ClosedLoop", "Held", "attempt", "planned", "prepared", "replanning"]


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
    """A scenario's conditions, ready for `simulate`: its keyword arguments are `options`."""

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
    """The closed loop of a scenario, whose plan starts at q0 (nq,), checked against robot and motion."""
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


def planned(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray,
    progress: Callable[[float], None] | None,
    method: str | None = None,
) -> Trajectory:
    """The scenario's plan from q0; `method` stands in for the scenario's own."""
    method = scenario.plan.get("method", "horizon") if method is None else method
    options = SearchOptions(time_limit=scenario.plan.get("time_limit"))
    trajectory = plan_problem(scenario.problem(sms, q0), method, options, progress)
    # r_th judges a plan; it does not steer it.
    return replace(trajectory, reach=scenario.plan.get("reach", trajectory.reach))


def replanning(scenario: Scenario, sms: SpaceManipulator, plan: Trajectory | None = None) -> Replanning:
    """A reference that plans again from the measured state; one run uses it up.

    Where the client has a sensor, what is planned for is its estimate. Waypoints without a time get that at
    which `plan` passes them: the loop cannot see what was passed.
    """
    seen = sensor(scenario)
    client = None if scenario.client is None else scenario.made_client(sms)
    estimate = None
    if client is not None and seen is not None:  # one measurement when the motion begins, late and noisy
        first = measured(client, -seen.latency, seen, np.random.default_rng(seen.seed))
        estimate = ClientEstimate(first, -seen.latency, seen)
    problem = scenario.problem(sms, dt=scenario.reference.get("dt"), client=estimate)
    if not any(isinstance(limit, AlphaBox) for limit in problem.limits):
        problem = replace(problem, limits=(*problem.limits, AlphaBox()))  # the paper's step has it always
    if plan is not None:
        limits = [
            one.timed(plan) if isinstance(one, Via) and one.time is None else one for one in problem.limits
        ]
        problem = replace(problem, limits=limits)
    options = ReplanOptions(
        dead_band=scenario.reference.get("dead_band"), jerk=scenario.per_joint(sms, "reference", "jerk")
    )
    hold = scenario.reference.get("hold", 0.0)
    if client is None or seen is None or estimate is None:
        return Replanning(problem, hold, options=options)
    return _Watching(problem, client, seen, estimate, hold=hold, options=options)


class _Watching(Replanning):
    """A `Replanning` to a client that a noisy and late sensor measures meanwhile; `client` is the true one.

    The problem's goal and obstacles hold the `estimate`, which each measurement renews. The last one is made
    a second before the deadline: what is corrected later leaves a velocity, and a hand that is near hides the
    markers.
    """

    def __init__(
        self, problem: Problem, client: Client, sensor: ClientSensor, estimate: ClientEstimate, **others: Any
    ) -> None:
        super().__init__(problem, **others)
        self._estimate, self._client, self._sensor = estimate, client, sensor
        self._rng = np.random.default_rng((sensor.seed, 1))
        self._look = sensor.period

    def observe(self, t: float, q: FloatArray, v: FloatArray) -> None:
        """Measure the client where that is due, then plan."""
        if self._look - 1e-9 <= t <= self.problem.duration - 1.0 + 1e-9:
            self._look += self._sensor.period
            then = t - self._sensor.latency
            if self._sensor.sees(then, self._rng):
                self._estimate.observe(measured(self._client, then, self._sensor, self._rng), then)
        super().observe(t, q, v)


class Held:
    """A plan made once, and for `hold` [s] after its end the rest that it ends in."""

    def __init__(self, plan: Trajectory, hold: float) -> None:
        self.q, self.target, self.sample = plan.q, plan.target, plan.sample
        self.momentum, self.base_mode = plan.momentum, plan.mode
        self.duration = plan.duration + hold


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
