"""Several inequalities as one limit, under one name."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from ffsms_pin.opt.limits.limit import Limit, Rows, Violation, stacked
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residuals
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.opt.parts.reading import residuals_of
from ffsms_pin.opt.step.state import StepState

__all__ = ["AllOf"]


class AllOf(Limit):
    """Inequalities in units of their own that are given, kept and reported together."""

    @property
    @abstractmethod
    def parts(self) -> list[Inequality]:
        """The inequalities."""

    def rows(self, step: StepState) -> Rows | None:
        """Of all of them."""
        return stacked([rows for part in self.parts if (rows := part.rows(step)) is not None])

    def residual(self, m: Features) -> Residuals:
        """Of all of them."""
        return [one for part in self.parts for one in residuals_of(part, m)]

    def violation(self, motion: Motions) -> Violation:
        """The largest amount of any of them."""
        found = [part.violation(motion) for part in self.parts]
        notes = [one.note for one in found if one.note]
        return Violation(
            max((one.amount for one in found), default=0.0),
            np.unique(np.concatenate([np.empty(0), *(one.instants for one in found)])),
            self.told(notes) if notes else "",
        )

    def told(self, notes: list[str]) -> str:
        """What is said of a motion that breaks some: their notes, in one."""
        return "; ".join(notes)
