"""The result of a simulated capture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ffsms_pin.capture.client_identification import IdentifiedClient
from ffsms_pin.capture.prediction import Prediction
from ffsms_pin.capture.recording import Captured
from ffsms_pin.capture.visual_replanning import rebound
from ffsms_pin.client import Client
from ffsms_pin.opt import Obstacle, Trajectory
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking


@dataclass(frozen=True, eq=False)
class Flight:
    """The result of a simulated capture.

    Attributes
    ----------
    plan : Trajectory
        The first plan.
    captured : Captured
        The recording of the capture, with its predictions.
    plant : SpaceManipulator
        The simulated servicer.
    note : str
        The note of the re-planning (`opt.Replanning.note`), for example failed joints or a predicted miss.
        Empty if there is nothing to note, or without re-planning.
    bodies : tuple of Obstacle
        The obstacles of the plan, without those of a guide.
    grasp : pinocchio.SE3
        The grasp frame, in the client's axes.
    """

    plan: Trajectory
    captured: Captured
    plant: SpaceManipulator
    note: str = ""
    bodies: tuple[Obstacle, ...] = ()
    grasp: Any = None

    def __repr__(self) -> str:
        return f"Flight({self.outcome}, {self.tracking.t[-1]:.4g} s)"

    @property
    def latched(self) -> bool:
        """True if the client was latched."""
        return self.captured.caught

    @property
    def outcome(self) -> str:
        """The outcome and its reason: "latched", "no go: ...", "given up: ..." or "collision: ...".

        After "latched", the text lists a stop by a guard, violated limits and colliding bodies, if any.
        """
        if self.latched:
            return "; ".join(["latched", *self.tracking.misses])
        names = [phase.name for phase in self.captured.phases]
        kind = "collision" if names[-1] == "collision" else "given up" if "closing" in names else "no go"
        return f"{kind}: {self.captured.missed.removeprefix('no go: ')}"

    @property
    def states(self) -> list[tuple[float, str, str]]:
        """The states of the capture, each with its start time [s], its name and the reason."""
        return [(phase.time, phase.name, phase.reason) for phase in self.captured.phases]

    @property
    def tracking(self) -> Tracking:
        """The recording of servicer and client, from the start to the end."""
        return self.captured.whole

    @property
    def client(self) -> Client:
        """The true client in free motion, with the shapes of the nozzle or ring at the grasp."""
        return self.captured.client

    def obstacles(self, client: Any = None) -> list[Obstacle]:
        """Return the obstacles `bodies`, with those of the client placed on `client`.

        Parameters
        ----------
        client : Client or simulation.ClientMotion, optional
            The client that carries the obstacles. Default: the true client in free motion.
        """
        return list(self.bodies) if client is None else rebound(self.bodies, client)

    @property
    def identified(self) -> IdentifiedClient | None:
        """The identified mass and inertia of the client; None if the client was not latched."""
        return self.captured.identified

    @property
    def prediction(self) -> Prediction:
        """The prediction at the last contact, or that of the first plan if there was no contact."""
        return self.captured.expected or self.captured.planned

    @property
    def momentum_error(self) -> float:
        """The largest error of the total momentum, relative to the largest initial momentum."""
        return self.captured.momentum_error
