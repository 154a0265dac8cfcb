"""Single instants of motions, where something is not asked of the whole motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, Residual

__all__ = ["Instants"]


class Instants(NamedTuple):
    """Which instants of which motions; arrays of one length V.

    Attributes
    ----------
    motion, instant : ndarray, shape (V,)
    """

    motion: Indices
    instant: Indices

    @classmethod
    def weighted(cls, motions: Motions) -> Instants:
        """Those that have a weight in an integral over the motion."""
        return cls(*np.nonzero(np.broadcast_to(motions.weights > 0.0, motions.rates.shape[1:])))

    def columns(self, motions: Motions) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations there, each (n, V)."""
        joints, rates, accelerations = (
            x[:, self.motion, self.instant] for x in (motions.joints, motions.rates, motions.accelerations)
        )
        return joints, rates, accelerations

    def residual(self, value: FloatArray, by: Sequence[FloatArray]) -> Residual:
        """A residual (V,) with its slopes (n, V) by joint positions, rates and accelerations."""
        by_joints, by_rates, by_accelerations = by
        return Residual(
            value,
            motion=self.motion,
            instants=self.instant,
            by_joints=by_joints,
            by_rates=by_rates,
            by_accelerations=by_accelerations,
        )
