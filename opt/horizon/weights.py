"""What a motion's merit is made of, and in which proportions."""

from __future__ import annotations

from dataclasses import dataclass

from ffsms_pin.opt.horizon.task import Task

__all__ = ["Weights"]


@dataclass(frozen=True)
class Weights:
    """Weights of the squares, and the smoothing of the cost's residual.

    Given for a motion of 8 s of an arm one metre long; `fitted` makes them those of a task, so that every
    term keeps its proportion to the cost integral.

    Attributes
    ----------
    end : float
        Of the distance at T [1/m^2].
    tail : float
        Of what the distance exceeds in the last tenth [1/m^2].
    clear : float
        Of what a clearance lacks, over time [1/(m^2 s)].
    rough : float
        Of the acceleration, over time [s^3]. Small: it decides between motions of equal cost.
    base : float
        Of the share of a base limit that is used beyond its margin, over time [1/s].
    slow, close : float
        See `cost_residual`.
    """

    end: float
    tail: float
    clear: float
    rough: float
    slow: float = 0.0
    close: float = 0.0
    base: float = 1.0

    def fitted(self, task: Task) -> Weights:
        """The weights for a task."""
        per_square = 1.0 / task.length**2
        return Weights(
            end=self.end * task.time * per_square,
            tail=self.tail * task.time * per_square,
            clear=self.clear * per_square,
            rough=self.rough * task.time**4,
            slow=self.slow,
            close=self.close * task.length,
            base=self.base,
        )
