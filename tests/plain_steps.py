"""Build the quadratic program of a step from its formulas, and solve it by DAQP."""

from __future__ import annotations

import daqp
import numpy as np
from clearances_at import Points

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.costs import ideal_cosine
from ffsms_pin.opt.evaluation import UNBOUNDED
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.step.state import StepState, rate_bounds
from ffsms_pin.opt.step.stepper import StepProblem, StepQP, StepWeights

__all__ = ["by_daqp", "plain_qp", "with_bound_rows"]


def plain_qp(
    sms: ffsms.SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    target: FloatArray,
    left: float,
    clearances: tuple[FloatArray, FloatArray] | None = None,
) -> StepProblem:
    """Return the matrices of docs/planner.md in the basis V of the stepper.

    Without `clearances` (values and gradients), the clearances of the paper's points are used.
    """
    dt, w, n = 0.01, StepWeights(), sms.n
    step = StepState(sms, q, rates, dt, left)
    V, J_v = step.V, step.J_star[:3]
    velocity, displacement = J_v @ rates, target - step.pose.translation
    distance = float(np.linalg.norm(displacement))
    towards = displacement / distance
    cosine = ideal_cosine(step.entropy, 10.0)
    across = velocity - (velocity @ towards) * towards
    if np.linalg.norm(across) < 1e-9:  # any perpendicular direction
        across = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
    e = cosine * towards + np.sqrt(1.0 - cosine**2) * across / np.linalg.norm(across)
    now = max(0.0, float(velocity @ e))
    gain = dt * float(np.abs(e @ J_v) @ sms.limits.acceleration)
    speed = min(kernel.reference_speed(distance / max(cosine, 0.2), now, left, dt), now + gain)
    H, g = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
    S = np.column_stack([J_v @ V, -e, np.zeros(3)])
    H += w.direction * S.T @ S
    H[:n, :n] += w.effort * np.eye(n) + w.change * V.T @ V
    H[n, n] += w.speed
    H[n + 1, n + 1] += w.clearance
    g[:n], g[n], g[n + 1] = -w.change * V.T @ rates, -w.speed * speed, w.clearance
    value, gradient = Points(sms).gradients(q) if clearances is None else clearances
    m = len(value)
    lower, upper = rate_bounds(sms.layout.positions(q), rates, sms.limits, dt)
    # If the box of alpha is soft, each side is a row.
    softness = AlphaBox().rows(step).softness
    none = np.full(n, UNBOUNDED)
    box = [(np.eye(n), np.zeros(n), -np.ones(n), np.ones(n))]
    if softness:
        box = [
            (np.eye(n), np.full(n, softness), -np.ones(n), none),
            (np.eye(n), np.full(n, -softness), -none, np.ones(n)),
        ]
    rows = [(V, np.zeros(n), lower, upper), *box]
    rows.append((gradient @ V, np.ones(m), -2.0 * (value - 0.012), np.full(m, UNBOUNDED)))
    return StepProblem(
        H=H,
        g=g,
        C=np.vstack([np.column_stack([G, np.zeros(len(G)), slack]) for G, slack, _, _ in rows]),
        l=np.concatenate([low for _, _, low, _ in rows]),
        u=np.concatenate([up for _, _, _, up in rows]),
        lower=np.concatenate([-none, [0.0, 0.0]]),
        upper=np.full(n + 2, UNBOUNDED),
    )


def by_daqp(problem: StepProblem) -> FloatArray:
    p = problem
    A = np.vstack([np.eye(p.g.size), p.C])
    low, up = np.concatenate([p.lower, p.l]), np.concatenate([p.upper, p.u])
    x, _, flag, _ = daqp.solve(p.H, p.g, A, up, low, np.zeros(len(up), dtype=np.int32), primal_tol=1e-11)
    assert flag == 1
    return np.asarray(x)


def with_bound_rows(problem: StepProblem) -> StepQP:
    """Return the program with its bounds as rows."""
    H, g, C, low, up, lower, upper = problem
    (bounded,) = (np.minimum(-lower, upper) < UNBOUNDED).nonzero()
    rows = np.concatenate([C, np.eye(len(g))[bounded]])
    return StepQP(H, g, rows, np.concatenate([low, lower[bounded]]), np.concatenate([up, upper[bounded]]))
