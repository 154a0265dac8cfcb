"""Joint positions to sample: a grid, or points that fill the joints' ranges evenly.

A row's joint positions depend on its number and the seed alone, so any chunk can be made without the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from ffsms_pin.checks import FloatArray, instance, one_of, positive, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

BLOCK = 65536  # rows of one Sobol net


@dataclass(frozen=True)
class Sampling:
    """Rows of joint positions between limits.

    Attributes
    ----------
    lower, upper : tuple of float
        Of each joint [rad] (prismatic joints [m]).
    rows : int
    method : {"sobol", "grid"}
        "sobol": every block of 65,536 rows is a Sobol net of its own, scrambled by the seed and the block's
        number. So rows cover the ranges evenly from the first block on, there can be any number of them, and
        the last block costs no more than the first. "grid": the same number of points on each joint, both
        limits among them, the last joint fastest; `rows` is that number to the power n.
    seed : int
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    rows: int
    method: str = "sobol"
    seed: int = 0

    @classmethod
    def of(cls, sms: SpaceManipulator, samples: int, method: str = "sobol", seed: int = 0) -> Sampling:
        """Over the joint limits of a robot; a revolute joint without limits runs over one turn.

        Of a grid, `samples` is the largest number of rows: it gets as many points on each joint as fit.

        Raises
        ------
        InvalidValue
            A prismatic joint has no limits, or the grid would have fewer than two points on each joint.
        """
        instance("sms", sms, SpaceManipulator)
        one_of("method", method, ("sobol", "grid"))
        rows, seed = whole("samples", samples, 1), whole("seed", seed, 0)
        positive("samples", rows)  # and no more than 1e12
        lower, upper = sms.limits.lower.copy(), sms.limits.upper.copy()
        for j, name in enumerate(sms.joint_names):
            if not (math.isfinite(lower[j]) and math.isfinite(upper[j])):
                if sms.model.joints[j + 2].shortname().startswith("JointModelP"):  # prismatic
                    raise InvalidValue("limits", (lower[j], upper[j]), f"of joint '{name}' must be finite")
                lower[j], upper[j] = -math.pi, math.pi
        if method == "grid":
            points = round(rows ** (1.0 / sms.n))
            points -= points**sms.n > rows
            if points < 2:
                least = f"must be at least {2**sms.n} for a grid of {sms.n} joints"
                raise InvalidValue("samples", samples, least)
            rows = points**sms.n
        return cls(tuple(lower.tolist()), tuple(upper.tolist()), rows, method, seed)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)

    @property
    def points(self) -> int:
        """Points on each joint; of a grid only."""
        return int(round(self.rows ** (1.0 / self.n)))  # noqa: RUF046

    def joints(self, rows: range) -> FloatArray:
        """Joint positions (len(rows), n) of consecutive rows [rad]."""
        instance("rows", rows, range)
        if self.method == "grid":
            index = np.arange(rows.start, rows.stop)
            places = np.unravel_index(index, (self.points,) * self.n)
            share = np.stack(places, axis=1) / (self.points - 1)
        else:
            share = self._net(rows)
        lower, upper = np.array(self.lower), np.array(self.upper)
        return np.asarray(lower + share * (upper - lower))

    def content(self) -> Mapping[str, Any]:
        """All of it, for JSON."""
        limits = {"lower": list(self.lower), "upper": list(self.upper)}
        return {"method": self.method, "rows": self.rows, "seed": self.seed, **limits}

    def _net(self, rows: range) -> FloatArray:
        parts = []
        for block in range(rows.start // BLOCK, -(-rows.stop // BLOCK)):
            # No number of a block's rows depends on how many of them are asked for.
            net = qmc.Sobol(self.n, seed=np.random.default_rng((self.seed, block))).random(BLOCK)
            start = block * BLOCK
            parts.append(net[max(rows.start - start, 0) : rows.stop - start])
        return np.concatenate(parts) if parts else np.empty((0, self.n))
