"""The paper's box constraint on its scaling factors alpha."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.evaluation import Rows, Violation
from ffsms_pin.opt.limits.limit import RATE_MARGIN, Inequality, SpeedBound
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts, singular
from ffsms_pin.opt.step.state import StepState


@dataclass(frozen=True)
class AlphaBox(Inequality):
    """The paper's |alpha_i| <= 1, with joint rates = V alpha.

    By default single steps have this limit, as in the paper. Whole motions have it if it is among the
    problem's limits. V is orthogonal, so the limit bounds the joint rate in each principal direction of the
    coupling by 1 rad/s.
    """

    name = "alpha box"
    unit = "rad/s"
    scale = 1.0
    margin = 0.02

    def slack(self, m: Variables) -> Any:
        """Return the slack of each |alpha_i| <= 1.

        The slopes of alpha_i with respect to joint rates are the column v_i of V. The v_i are eigenvectors of
        C^T C with eigenvalues lambda_i, where C = C_bm. The differential dv_i is the sum over j != i of
        v_j (v_j^T d(C^T C) v_i) / (lambda_i - lambda_j).
        """
        rates, C = m.rollouts.rates, m.rollouts.arm.coupling
        n, shape = len(rates), rates.shape[1:]
        C = C.reshape(6, n, -1)
        sigma, V = singular(C)
        alpha = np.einsum("bmi,mb->ib", V, rates.reshape(n, -1))

        def slopes() -> dict[str, FloatArray]:
            CV = np.einsum("kmb,bmi->kib", C, V)
            s = np.pad(sigma, ((0, n - len(sigma)), (0, 0)))
            difference = s[:, None] - s
            # The sum also excludes directions with equal singular values.
            gap = np.where(np.abs(difference) <= 1e-8 * s[0], np.inf, difference * (s[:, None] + s))
            along = np.einsum("bmj,ijb->imb", V, alpha / gap)
            slope = np.einsum("kib,imb->ikmb", CV, along)
            slope += np.einsum("kmb,imb,bni->iknb", C, along, V)
            return {
                "by_rates": V.transpose(2, 1, 0).reshape(n, n, *shape),
                "by_coupling": slope.reshape(n, 6, n, *shape),
            }

        return 1.0 - abs(m.variable(alpha.reshape(n, *shape), slopes))

    def rows(self, step: StepState) -> Rows:
        """Return the rows -1 <= V^T u <= 1 of the paper.

        V rotates from step to step, so fast joint rates that were inside the box may now be outside. The rows
        are hard if the norm of the present rates is at most 1 rad/s, or if the rates after the hardest
        braking satisfy the rows. Otherwise the slack of the step (`Step.slack`) relaxes them as little as
        possible.
        """
        ones = np.ones(step.sms.n)
        # V is orthogonal, so rates with a norm of at most 1 are in the box.
        slow = step.rates.dot(step.rates) <= 1.0
        kept = slow or np.abs(step.V.T.dot(np.clip(0.0, *step.bounds))).max() <= 1.0
        # With the softness of 10 rad/m the clearances, which share the slack, are relaxed by centimetres per
        # second at most. A violation still costs several times its benefit in speed or direction.
        return Rows(step.V.T, -ones, ones, 0.0 if kept else 10.0)

    def speed_bound(self, motion: Rollouts) -> SpeedBound:
        """Return the bounds on the speed along a path from |alpha_i| <= 1."""
        slope = 1.0 - self.slack(Variables(motion)).value[:, 0]
        most = np.ones(len(slope))
        return SpeedBound(np.zeros(len(slope)), slope, most, np.inf * most)

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest excess of |alpha_i| over 1, with V at each step's start, as in the paper."""
        most = np.abs(motion.paired.alpha).max(axis=1)
        binds = motion.times[2::2][most > 1.0 - self.margin]
        largest = float(most.max(initial=0.0))
        if largest <= 1.0 + 1e-6:  # the solver's tolerance
            return Violation(0.0, binds)
        return Violation(largest - 1.0, binds, _note(largest))

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return the largest excess of |alpha_i| over 1; zero if it is at most `RATE_MARGIN`."""
        largest = 1.0 - float(self.slacks(Variables(motion)).value.min())
        return Violation(largest - 1.0, note=_note(largest)) if largest > 1.0 + RATE_MARGIN else Violation()


def _note(largest: float) -> str:
    return f"|alpha_i| reaches {largest:.4g}, the paper's box allows at most 1"
