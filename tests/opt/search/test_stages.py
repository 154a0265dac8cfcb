"""The choice of motions for the next stage."""

from __future__ import annotations

import numpy as np
from horizon_parts import COARSE, planar_problem

import ffsms_pin as ffsms
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, distinct_best, linearise
from ffsms_pin.opt.search.inverse_kinematics import straight_moves


def test_motions_in_collision_are_ranked_after_the_others(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar)
    model = Model.make(problem, COARSE)
    goals = problem.joints0 + np.array([[0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.4, 0.01], [0.0, 0.0, 0.5]])
    motions = linearise(model, straight_moves(problem, model.spline, goals), LAST_WEIGHTS)
    motions.merit[:] = [1.0, 1.1, 1.2, 1.3]
    motions.objective[:] = 0.0
    motions.limit_share[:] = motions.blocked_share[:] = 0.0

    def order(keep: int) -> list[float]:
        return [float(merit) for merit in distinct_best(motions, keep).merit]

    # The second and the third motion are nearly equal.
    assert order(4) == [1.0, 1.1, 1.3]
    # Violated limits other than collisions, such as missed waypoints, do not matter.
    motions.limit_share[:] = [2.5, 0.9, 0.0, 1.2]
    assert order(4) == [1.0, 1.1, 1.3]
    motions.blocked_share[:] = [2.5, 0.9, 0.0, 1.2]
    assert order(3) == [1.1, 1.3, 1.0]
    assert order(1) == [1.1]
