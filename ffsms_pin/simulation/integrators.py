"""The integrators of the forward dynamics by name; all work on the configuration manifold."""

from __future__ import annotations

from typing import Any, Protocol

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation.adaptive import adaptive_step, stiff_step
from ffsms_pin.simulation.disturbances import GeneralisedForce
from ffsms_pin.simulation.runge_kutta import rk4_step
from ffsms_pin.simulation.variational import variational_step

__all__ = ["INTEGRATORS", "Integrator", "integrator", "rk4_step"]


class Integrator(Protocol):
    """One step of the forward dynamics: see `rk4_step`."""

    def __call__(
        self,
        model: Any,
        data: Any,
        q: FloatArray,
        v: FloatArray,
        tau: FloatArray | GeneralisedForce,
        dt: float,
        t: float = 0.0,
    ) -> tuple[FloatArray, FloatArray, float]:
        """State after the step, and the work done in it."""


INTEGRATORS: dict[str, Integrator] = {
    "rk4": rk4_step,
    "variational": variational_step,
    "adaptive": adaptive_step,
    "stiff": stiff_step,
}


def integrator(name: str) -> Integrator:
    """The integrator of that name; `InvalidValue` lists those that there are."""
    try:
        return INTEGRATORS[name]
    except (KeyError, TypeError):
        raise InvalidValue("integrator", name, f"must be one of {', '.join(INTEGRATORS)}") from None
