"""Obstacles that make a problem impossible from the start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.limits.clearance.obstacle import Obstacle

if TYPE_CHECKING:
    from ffsms_pin.opt.problem import Problem

__all__ = ["check_obstacles"]


def check_obstacles(
    problem: Problem, touched: tuple[float, str] | None, obstacles: Sequence[Obstacle]
) -> None:
    """Raise where no motion can keep clear of the obstacles.

    Parameters
    ----------
    problem : Problem
    touched : tuple of float and str, optional
        The deepest overlap at the start [m], and of which pair.
    obstacles : sequence of Obstacle

    Raises
    ------
    InvalidValue
        A body overlaps an obstacle at the start, or the target lies inside one at the deadline.
    """
    if touched is not None:
        depth, pair = touched
        raise InvalidValue(
            "q0",
            problem.joints0.round(6),
            f"must keep clear of obstacles: {pair} overlap by {1e3 * depth:.1f} mm at the start; move "
            "the start or the obstacle",
        )
    target = problem.goal.place(problem.duration).position
    for obstacle in obstacles:
        if obstacle.on_base:
            continue  # where the base will be is not known
        depth = -obstacle.distance(target, problem.duration)
        if depth > problem.goal.tolerance:
            raise InvalidValue(
                "target",
                target,
                f"must lie outside obstacles: it is {1e3 * depth:.1f} mm inside '{obstacle.name}'; move "
                "the target or the obstacle",
            )
