"""The motion of a capture up to the contact: the client's first estimate, the plan and the reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ffsms_pin import checks, opt
from ffsms_pin.capture.camera import Camera, measured
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.guides import Scene
from ffsms_pin.capture.options import Belief, Grip, Nozzle, Planning, Replan, Ring
from ffsms_pin.capture.visual_replanning import VisualReplanning, grasp_at, rebound
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client
from ffsms_pin.client.client import placed_shapes
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.plans import plan_problem, replannable
from ffsms_pin.opt.problem import default_limits
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Reference
from ffsms_pin.simulation.held import Held


@dataclass(frozen=True, eq=False)
class Rendezvous:
    """The planning of a servicer's motion to a client; the attributes are arguments of `fly`.

    Attributes
    ----------
    sms : SpaceManipulator
    q0 : array_like, shape (nq,)
        Initial configuration.
    goal : opt.Meet
        The goal with the true client.
    duration : float
        Time to the contact [s].
    planning : Planning
    camera : Camera, optional
    belief : Belief, optional
    grip : Grip, optional
    guide : Nozzle or Ring, optional
    """

    sms: SpaceManipulator
    q0: Any
    goal: opt.Meet
    duration: float = 12.0
    planning: Planning = field(default_factory=Planning)
    camera: Camera | None = None
    belief: Belief | None = None
    grip: Grip | None = None
    guide: Nozzle | Ring | None = None

    def __post_init__(self) -> None:
        checks.instance("sms", self.sms, SpaceManipulator)
        checks.set_frozen(self, q0=self.sms.checked_configuration("q0", self.q0))
        if not isinstance(self.goal, opt.Meet):
            message = "must be opt.Meet(client, grasp)"
            advice = "" if isinstance(self.goal, Client) else "; opt.plan plans motions to other goals"
            raise InvalidValue("goal", self.goal, message + advice)
        if not isinstance(self.goal.client, Client):
            message = "must be the true ffsms_pin.Client; its estimate is set by camera= and belief="
            raise InvalidValue("goal.client", self.goal.client, message)
        checks.set_frozen(self, duration=checks.positive("duration", self.duration, "s"))
        checks.instance("planning", self.planning, Planning)
        checks.instance("camera", self.camera, Camera, optional=True)
        checks.instance("belief", self.belief, Belief, optional=True)
        checks.instance("grip", self.grip, Grip, optional=True)
        checks.instance("guide", self.guide, (Nozzle, Ring), optional=True)
        if self.belief is not None and self.camera is None:
            message = "requires a camera: add camera=capture.Camera()"
            raise InvalidValue("belief", self.belief, message)
        for obstacle in self.given_obstacles:
            if obstacle.moves and obstacle.on is not self.goal.client:
                name = f"obstacle '{obstacle.name}': on" if obstacle.name else "obstacle.on"
                raise InvalidValue(name, obstacle.on, "must be 'inertial', 'base', or the client of the goal")

    @cached_property
    def scene(self) -> Scene | None:
        """The contact scene of the nozzle or ring at the grasp; None without a guide."""
        return None if self.guide is None else self.guide.scene(self.goal.grasp)

    @cached_property
    def client(self) -> Client:
        """The true client, with the shapes of a guide."""
        assert isinstance(self.goal.client, Client)  # checked in __post_init__
        return _with_guide(self.goal.client, self.scene)

    @property
    def meet(self) -> opt.Meet:
        """The goal with the true client, including the shapes of a guide."""
        return replace(self.goal, client=self.client)

    @property
    def clearance(self) -> opt.Clearance:
        """The first clearance limit of the plan, or the default `opt.Clearance` if the plan has none."""
        return next((limit for limit in self._limits if isinstance(limit, opt.Clearance)), opt.Clearance())

    @cached_property
    def _limits(self) -> tuple[opt.Limit, ...]:
        limits = self.planning.limits
        return default_limits() if limits is None else tuple(limits)

    @cached_property
    def given_obstacles(self) -> tuple[opt.Obstacle, ...]:
        """The obstacles of the clearance limit and of the planning options; unnamed ones get names."""
        limit = self.clearance
        return tuple(
            replace(limit, obstacles=[*limit.obstacles, *self.planning.obstacles], _stacks=()).obstacles
        )

    def obstacles(self, client: Any) -> list[opt.Obstacle]:
        """Return the obstacles, including a guide; those on the client are placed on `client`."""
        return _guided(rebound(self.given_obstacles, client), self.guide, self.scene, client)

    def bodies(self) -> list[opt.Obstacle]:
        """Return the obstacles on the true client and the exact pieces of a guide.

        The list is empty if no obstacle is on the client.
        """
        bodies = [obstacle for obstacle in rebound(self.given_obstacles, self.client) if obstacle.moves]
        return _touched(bodies, self.guide, self.scene, self.client)

    def first_estimate(self) -> Client | ClientEstimate:
        """Return the client as known at the start of the motion.

        With a camera, the client is estimated from a first measurement with latency and noise. Without a
        camera, the true client is known.
        """
        if self.camera is None:
            return self.client
        return first_estimate(self.client, self.camera, self.belief)

    def problem(
        self,
        q0: FloatArray | None = None,
        client: Client | ClientEstimate | None = None,
        dt: float | None = None,
    ) -> opt.Problem:
        """Return the planning problem.

        Parameters
        ----------
        q0 : ndarray, shape (nq,), optional
            The configuration at the start of the plan. Default: the attribute `q0`.
        client : Client or ClientEstimate, optional
            The known or estimated client, with the start as its time zero. Default: `first_estimate`.
        dt : float, optional
            Time step [s]. Default: that of the planning options.
        """
        client = self.first_estimate() if client is None else client
        planning, coast = self.planning, 0.0 if self.grip is None else self.grip.time
        if self.goal.coast is not None:
            coast = self.goal.coast
        limits = list(self._limits)
        around = self.obstacles(client)
        if around and not any(isinstance(limit, opt.Clearance) for limit in limits):
            limits.append(self.clearance)
        limits = [
            replace(limit, obstacles=around, _stacks=()) if isinstance(limit, opt.Clearance) else limit
            for limit in limits
        ]
        return opt.Problem(
            self.sms,
            self.q0 if q0 is None else q0,
            replace(self.goal, client=client, coast=coast),
            self.duration,
            planning.dt if dt is None else dt,
            planning.terms,  # type: ignore[arg-type]  # None: the default
            limits,
            planning.joint_rates,
            planning.momentum,
            planning.locked,
            planning.mode,
            planning.wheel_momentum,
        )

    def plan(self) -> opt.Trajectory:
        """Return the plan to the client as estimated at the start."""
        return plan_problem(self.problem(), "horizon", self.planning.search or opt.SearchOptions())

    def replanning(self, plan: opt.Trajectory | None = None, replan: Replan | None = None) -> opt.Replanning:
        """Return a reference that re-plans from the measured state to the known or estimated client."""
        replan = Replan() if replan is None else replan
        known = self.first_estimate()
        problem = replannable(self.problem(client=known, dt=replan.dt), plan)
        if self.camera is None or not isinstance(known, ClientEstimate):
            return opt.Replanning(problem, plan=plan, options=replan)
        return VisualReplanning(problem, self.client, self.camera, known, plan=plan, options=replan)

    def reference(self, plan: opt.Trajectory, replan: Replan | None) -> Reference:
        """Return the reference up to the contact; it is re-planned unless `replan` is None."""
        if replan is not None:
            return self.replanning(plan, replan)
        return plan if self.camera is None else Held(plan, 0.0, self.target)

    @property
    def target(self) -> Callable[[float], FloatArray]:
        """A function that takes a time [s] and returns the true position of the grasp (3,) [m]."""
        return grasp_at(self.meet)

    def known(self, reference: Reference) -> Client | ClientEstimate:
        """Return the estimate that a reference updates by camera measurements, or else `first_estimate`."""
        return reference.estimate if isinstance(reference, VisualReplanning) else self.first_estimate()


def first_estimate(client: Client, camera: Camera, belief: Belief | None = None) -> ClientEstimate:
    """Return the estimate of a client from a first measurement with latency and noise, before a motion."""
    belief = Belief() if belief is None else belief
    mass = client.mass if belief.mass is None else belief.mass
    body = Client(mass, client.inertia if belief.inertia is None else belief.inertia)
    first = measured(client, -camera.latency, camera, np.random.default_rng(camera.seed), body)
    return ClientEstimate(first, -camera.latency, camera, belief.mass_deviation, belief.inertia_deviation)


def _with_guide(client: Client, scene: Scene | None) -> Client:
    """Return the client with the additional shapes of a nozzle or ring."""
    if scene is None:
        return client
    guided = copy(client)
    checks.set_frozen(guided, shapes=placed_shapes("shapes", [*client.shapes, *scene.shapes]))
    return guided


def _guided(
    obstacles: Sequence[opt.Obstacle], guide: Nozzle | Ring | None, scene: Scene | None, client: Any
) -> list[opt.Obstacle]:
    """Return the obstacles and, for a client with a guide, the hull and the walls of the guide.

    The walls are the convex pieces from which plans keep the end effector clear.
    """
    if guide is None or scene is None or client is None:
        return list(obstacles)
    whole = opt.Obstacle(scene.hull, on=client, name=guide.name, grasp=scene.grasp)
    walls = [
        opt.Obstacle(shape, place, client, name=f"{guide.name} wall {i}", grasp=scene.grasp, piece_of=whole)
        for i, (shape, place) in enumerate(scene.walls, start=1)
    ]
    return [*obstacles, whole, *walls]


def _touched(
    bodies: Sequence[opt.Obstacle], guide: Nozzle | Ring | None, scene: Scene | None, client: Client
) -> list[opt.Obstacle]:
    """Return the bodies of a client and the exact pieces of its guide; empty without bodies."""
    if guide is None or scene is None or not bodies:
        return list(bodies)
    pieces = [
        opt.Obstacle(shape, place, client, name=f"{guide.name} {i}", grasp=scene.grasp)
        for i, (shape, place) in enumerate(scene.shapes, start=1)
    ]
    return [*bodies, *pieces]
