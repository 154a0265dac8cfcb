"""Which motions go on to the next stage."""

from __future__ import annotations

import numpy as np
from horizon_parts import COARSE, planar_problem

import ffsms_pin as ffsms
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, distinct_best, linearise
from ffsms_pin.opt.search.inverse_kinematics import straight_moves


def test_a_motion_through_a_body_goes_on_after_the_others(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar)
    model = Model.make(problem, COARSE)
    goals = problem.joints0 + np.array([[0.3, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.4, 0.01], [0.0, 0.0, 0.5]])
    motions = linearise(model, straight_moves(problem, model.spline, goals), LAST_WEIGHTS)
    motions.merit[:] = [1.0, 1.1, 1.2, 1.3]
    motions.objective[:] = 0.0
    motions.limit_share[:] = motions.blocked_share[:] = 0.0

    def order(keep: int) -> list[float]:
        return [float(one) for one in distinct_best(motions, keep).merit]

    # The second and the third have come together.
    assert order(4) == [1.0, 1.1, 1.3]
    # A waypoint that is not passed yet, say, does not matter.
    motions.limit_share[:] = [2.5, 0.9, 0.0, 1.2]
    assert order(4) == [1.0, 1.1, 1.3]
    motions.blocked_share[:] = [2.5, 0.9, 0.0, 1.2]
    assert order(3) == [1.1, 1.3, 1.0]
    assert order(1) == [1.1]
