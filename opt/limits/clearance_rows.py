"""Rows of a step that keep bodies clear of each other."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.body_model import BodyModel
from ffsms_pin.opt.limits.body_stack import BodyStack
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.points import Points
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system import SpaceManipulator

__all__ = ["CLOSING_RATE", "MARGIN", "ClearanceModel", "clearance_model", "clearance_rows"]

# [1/s] A clearance may shrink at most this fast relative to what is left of it: slow enough for the arm to
# brake (the paper's arm stops an end effector from 0.2 m/s within a second), fast enough to pass near.
CLOSING_RATE = 2.0
# [m] Kept beyond the asked clearance, so that it also holds between nodes and in spite of curvature.
MARGIN = 2e-3


class ClearanceModel(Protocol):
    """Clearances as functions of the joints: distances do not change when the base moves with the arm."""

    @property
    def count(self) -> int:
        """Number of clearances, m."""

    def names(self) -> list[str]:
        """What each clearance is between, in order."""

    def values(self, q: FloatArray) -> FloatArray:
        """Clearances (m,) at q (nq,) [m], negative where bodies overlap."""

    def gradients(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,) [m] and their gradients (m, n) by the joints [m/rad] at q (nq,)."""

    def least(self, q: FloatArray, below: FloatArray | None = None) -> tuple[FloatArray, Indices]:
        """The least of each clearance (m,) [m] over configurations (k, nq), and at which of them (m,).

        Only what is below `below` (m,) is looked for; where nothing is, `below` stands for the clearance.
        """


def clearance_model(sms: SpaceManipulator, collision: str, clearance: float = 0.0) -> ClearanceModel | None:
    """The clearances that a mode keeps, with scratch memory for one thread; None for "off".

    Raises
    ------
    InvalidValue
        The mode is not known, or the robot has no base box ("points") or no shapes that can meet.
    """
    if collision == "off":
        return None
    if collision not in ("points", "hulls", "shapes"):
        raise InvalidValue("collision", collision, 'must be "points", "hulls", "shapes" or "off"')
    return Points(sms) if collision == "points" else BodyModel(BodyStack(sms, collision, clearance))


def clearance_rows(model: ClearanceModel, kept: float, step: StepState) -> Rows:
    """Rows gradient . u >= -CLOSING_RATE (clearance - kept - MARGIN), which give way as fast as the slack.

    Parameters
    ----------
    model : ClearanceModel
    kept : float
        What is to be kept [m].
    step : StepState
    """
    if isinstance(model, BodyModel):
        limits = step.sms.limits
        fastest = np.minimum(np.abs(step.rates) + limits.acceleration * step.dt, limits.velocity)
        # Beyond this distance rates up to the fastest are too slow for a row to bind.
        near = kept + MARGIN + model.reaches.dot(fastest) / CLOSING_RATE
        value, gradient = model.gradients(step.q, near)
    else:
        value, gradient = model.gradients(step.q)
    least = CLOSING_RATE * (kept + MARGIN - value)
    return Rows(gradient, least, np.full(least.size, UNBOUNDED), give=1.0)
