"""The best joint rates of a step within all its limits, by the shortest way to them."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_rows import BaseRows
from ffsms_pin.opt.clearance_rows import ClearanceRows, Rows
from ffsms_pin.opt.momentum_drift import Drift
from ffsms_pin.opt.rate_bounds import RateBounds
from ffsms_pin.opt.step_kinetics import StepKinetics
from ffsms_pin.opt.step_programme import StepProgramme
from ffsms_pin.opt.step_qp import StepProblem
from ffsms_pin.system import SpaceManipulator

__all__ = ["StepLimits"]


class StepLimits:
    """Solves a programme whose objective is written, and writes its limits as far as they are needed.

    The objective is strictly convex. So the best rates of all are the solution where they keep the limits,
    and the best within the bounds on the joint rates are where they keep the other ones: one of the two is
    true in most steps, and costs a tenth of the whole programme, which is written where neither is.

    Parameters
    ----------
    sms : SpaceManipulator
    programme : StepProgramme
    clear : ClearanceRows or None
    base : BaseRows or None

    Attributes
    ----------
    base : BaseRows or None
    asked_solver : bool
        Whether the last solution took ProxQP.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        programme: StepProgramme,
        clear: ClearanceRows | None,
        base: BaseRows | None,
    ) -> None:
        self._sms, self._plain = sms, sms.layout.plain
        self._programme, self._clear, self.base = programme, clear, base
        self._whole, self.asked_solver = False, False

    def set_dt(self, dt: float) -> None:
        """The length of the steps from now on [s]."""
        self._dt, self._bounds = dt, RateBounds(self._sms.limits, dt)

    def reset(self) -> None:
        """Forget the last solution."""
        self._programme.reset()
        self._whole = False
        if self._clear is not None:
            self._clear.forget()

    def solve(
        self, kinetics: StepKinetics, drift: Drift | None, q: FloatArray, rates: FloatArray, time_left: float
    ) -> tuple[FloatArray, bool]:
        """Joint rates (n,), and whether they solve the programme; where it is not solved the arm brakes.

        Parameters
        ----------
        kinetics : StepKinetics
            At q.
        drift : Drift or None
        q, rates : ndarray, shape (nq,), (n,)
            At the step's start.
        time_left : float
            [s]
        """
        joints, rows = self._joints(q), None
        # Another limit that held back the last step will mostly hold back this one.
        if self.base is None and not self._whole:
            chosen = self._within_bounds(joints, rates.tolist())
            if chosen is not None and _in_box(chosen, kinetics.V):
                rows = self._rows(kinetics, joints, chosen.tolist())
                if rows is None or rows.met(chosen):
                    self.asked_solver = False
                    return chosen, True
        programme = self._programme
        self._write(kinetics, drift, q, rates, time_left, joints, rows)
        found, solved = programme.solve(self._whole)
        self.asked_solver = programme.solver.asked
        self._whole = self.base is not None or not programme.within_is_whole()
        if not self._whole:
            # The same solution the other way, so that its last digits do not depend on the way.
            chosen = programme.bounded(programme.lower.tolist(), programme.upper.tolist())
            if chosen is not None:
                return chosen[:-1], True
        # Within the solver's tolerance already; this makes the limits hold to the last bit.
        chosen = np.maximum(found if solved else 0.0, programme.lower)
        return np.minimum(chosen, programme.upper), solved

    def build(
        self, kinetics: StepKinetics, drift: Drift | None, q: FloatArray, rates: FloatArray, time_left: float
    ) -> StepProblem:
        """The whole programme, in alpha; arguments as for `solve`."""
        joints = self._joints(q)
        rows = None if self._clear is None else self._clear.measure(kinetics.data)
        self._write(kinetics, drift, q, rates, time_left, joints, rows)
        return self._programme.in_alpha(kinetics.V)

    def _joints(self, q: FloatArray) -> list[float]:
        """Joint positions."""
        joints: list[float] = (q[7:] if self._plain else self._sms.layout.positions(q)).tolist()
        return joints

    def _within_bounds(self, joints: list[float], rates: list[float]) -> FloatArray | None:
        """The best joint rates within their bounds; None where they were not found."""
        programme = self._programme
        if not any(programme.within.sides):
            # Most steps are far from the bounds, and need not work them out.
            x = programme.free()
            if x is None:
                return None
            *wanted, speed = x.tolist()
            # Written so that a NaN keeps no limit.
            if speed >= 0.0 and self._bounds.allow(joints, rates, wanted):
                return x[:-1]
        x = programme.bounded(*self._bounds.of(joints, rates))
        return None if x is None else x[:-1]

    def _rows(self, kinetics: StepKinetics, joints: list[float], rates: list[float]) -> Rows | None:
        """The rows of the clearances; None where rates of this size are known to meet them."""
        if self._clear is None or self._clear.certain(joints, rates, kinetics.data):
            return None
        return self._clear.measure(kinetics.data)

    def _write(
        self,
        kinetics: StepKinetics,
        drift: Drift | None,
        q: FloatArray,
        rates: FloatArray,
        time_left: float,
        joints: list[float],
        rows: Rows | None,
    ) -> None:
        """Write all limits, with the rows of the clearances if they were measured already."""
        programme = self._programme
        lower, upper = self._bounds.of(joints, rates.tolist())
        programme.bound(kinetics.V, rates, lower, upper)
        if self._clear is not None:
            fastest = [max(-low, up) for low, up in zip(lower, upper, strict=True)]
            programme.keep_clear(self._rows(kinetics, joints, fastest) if rows is None else rows)
        if self.base is not None:
            root = None if drift is None else drift.root
            programme.hold_base(
                *self.base.rows(q, rates, kinetics.coupling, root, self._dt, time_left),
            )


def _in_box(rates: FloatArray, V: FloatArray) -> bool:
    """Whether |alpha_i| <= 1: V turns, so within the ball of radius 1 they are."""
    return bool(rates.dot(rates) <= 1.0 or np.abs(rates.dot(V)).max() <= 1.0)
