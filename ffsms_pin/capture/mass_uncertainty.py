"""The uncertainty of a servicer's masses, and robots with deviating masses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from inspect import signature
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, at_least_zero
from ffsms_pin.options import Share, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import random_plants

_SURE = 1e-6  # relative deviation below which a mass counts as known
_LEAST, _MOST = 0.5, 2.0  # bounds of the factors on masses and inertias


@dataclass(frozen=True)
class MassUncertainty:
    """The standard deviations of a servicer's masses, as shares of the model's masses.

    Raises
    ------
    InvalidValue
        A deviation is no number, or below zero.
    """

    arm: Annotated[Share, Unit()] = 0.0
    """The relative standard deviation of the mass of each arm body; a body's inertia scales with its mass."""
    base: Annotated[Share, Unit()] = 0.0
    """The relative standard deviation of the base's mass."""
    base_inertia: Annotated[Share, Unit()] = 0.0
    """The relative standard deviation of the base's inertia."""

    def __post_init__(self) -> None:
        for field in fields(self):
            at_least_zero(f"masses {field.name}", getattr(self, field.name))

    @classmethod
    def of_plant(
        cls, errors: Mapping[str, Any], drawn: Mapping[str, Any] | None = None, **chosen: float
    ) -> MassUncertainty:
        """Return the standard deviations that match the constant and the random errors of a plant's masses.

        `errors` has fields of `simulation.InertialError`. `drawn` has keyword arguments of
        `simulation.random_plants`, or is None if there are no random errors. Fields in `chosen` replace the
        resulting deviations.
        """
        base = errors.get("base_mass", 1.0)
        factors = {"arm_mass": 1.0, "base_mass": base, "base_inertia": base}
        deviations = {}
        for key, default in factors.items():
            share = 0.0
            if drawn is not None:
                share = drawn.get(key, signature(random_plants).parameters[key].default)
            drawn_deviation = share / math.sqrt(3.0)  # uniform distribution from -share to share
            bias = float(np.abs(np.asarray(errors.get(key, default)) - 1.0).max())
            deviations[key.removesuffix("_mass")] = math.hypot(drawn_deviation, bias)
        return cls(**{**deviations, **chosen})

    def robots(
        self, sms: SpaceManipulator, shown: tuple[FloatArray, FloatArray] | None = None
    ) -> tuple[SpaceManipulator, list[SpaceManipulator]]:
        """Return the most likely robot, and robots one sigma away from it in independent directions.

        If all standard deviations are zero, return `sms` and an empty list. The motion of a floating robot
        determines the ratios of its masses but not their scale. Let r (n + 1,) be the relative changes of the
        ratios of the arm's n masses and of the base's inertia to the base's mass. `shown` has the information
        matrix G (n + 1, n + 1) of r, and the vector G r (`opt.Replanning.shown`). The posterior of all masses
        follows from `shown` and the standard deviations, to first order.
        """
        n = sms.n
        sigmas = np.array([self.base, *[self.arm] * n, self.base_inertia])
        if (sigmas < _SURE).all():
            return sms, []
        precision = np.diag(np.maximum(sigmas, _SURE) ** -2.0)
        mean = np.zeros(n + 2)
        ratios = np.hstack([-np.ones((n + 1, 1)), np.eye(n + 1)])
        if shown is not None:
            precision = precision + ratios.T @ shown[0] @ ratios
            mean = np.linalg.solve(precision, ratios.T @ shown[1])
        sizes, axes = np.linalg.eigh(np.linalg.inv(precision))
        moves = (axes * np.sqrt(np.maximum(sizes, 0.0))).T
        return _scaled(sms, mean), [_scaled(sms, mean + x) for x in moves if np.abs(x).max() > _SURE]


def _scaled(sms: SpaceManipulator, changes: FloatArray) -> SpaceManipulator:
    """Return the robot with relative changes (n + 2,) of base mass, arm masses and base inertia.

    The inertia of an arm body changes with its mass.
    """
    base, *arm, base_inertia = np.clip(1.0 + changes, _LEAST, _MOST).tolist()
    factors = zip(list(sms.model.inertias)[1:], [base, *arm], [base_inertia, *arm], strict=True)
    return sms.with_inertias(
        [
            pin.Inertia(on_mass * body.mass, body.lever, on_inertia * body.inertia)
            for body, on_mass, on_inertia in factors
        ]
    )
