"""The paper's box on its scaling factors, |alpha_i| <= 1 (below Eq. SVD_3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.limits.rate_bounds import rate_bounds
from ffsms_pin.opt.limits.step_state import StepState

if TYPE_CHECKING:
    from ffsms_pin.opt.batch.motions import Motions
    from ffsms_pin.opt.batch.residual import Residual

__all__ = ["AlphaBox", "alpha_box_rows"]

# [rad/m] How fast the box gives way with the slack: so fast that the clearances, which share the slack, give
# way by centimetres a second at most; still some times dearer than any speed or direction gained by it.
_GIVE = 10.0


def alpha_box_rows(step: StepState) -> Rows:
    """Rows -1 <= V^T u <= 1, exactly as printed.

    V turns from step to step, so fast joint rates that were within the box may now be outside, and no
    acceleration that the joints have brings them back in one step. The box is kept without giving way where
    an arm that brakes as fast as its joints may is within it at the step's end: then it can be kept.
    Elsewhere it gives way by the slack, which the step returns (`Step.slack`), as little as possible.
    """
    n = step.sms.n
    rows = Rows(step.V.T, np.full(n, -1.0), np.ones(n))
    # V turns without stretching: within the ball of radius 1 all rates are in the box.
    if step.rates @ step.rates <= 1.0:
        return rows
    lower, upper = rate_bounds(step.joints, step.rates, step.sms.limits, step.dt)
    braking: FloatArray = np.minimum(np.maximum(0.0, lower), upper)
    if np.abs(step.V.T @ braking).max() <= 1.0:
        return rows
    return rows._replace(give=_GIVE)


class AlphaBox(Limit):
    """The paper's |alpha_i| <= 1, a limit of single steps.

    The factors belong to one step's basis V, so whole motions, which are planned in joint rates, are not held
    to it: they keep the joints' own limits on rates.
    """

    name = "alpha box"

    def rows(self, step: StepState) -> Rows:
        """Rows of a step; see `alpha_box_rows`."""
        return alpha_box_rows(step)

    def residual(self, motions: Motions) -> list[Residual]:
        """Nothing: whole motions are not held to it."""
        return []

    def violation(self, motion: Motions) -> Violation:
        """Nothing: whole motions are not held to it."""
        return Violation()
