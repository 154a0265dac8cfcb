"""Gauss-Newton sums of the kernel against plain sums over the rows of residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from horizon_parts import TINY, integrated, spline_of
from slopes import motions, tip_turning_slopes

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.rollouts import Rollouts, coupling_slopes, velocity_slopes
from ffsms_pin.opt.search.gauss_newton import Weighted, gradients_and_hessians
from ffsms_pin.opt.search.spline import RateSpline

WeightedResidual = tuple[opt.Variable, FloatArray]
ROBOTS = ("planar_3r", "satellite_panda")
MOTIONS = 3
SHAPES = {
    "by_joints": "n", "by_rates": "n", "by_accelerations": "n",
    "by_tip": "3", "by_turn": "3", "by_velocity": "3", "by_spin": "3",
    "by_base": "3", "by_base_turn": "3", "by_base_spin": "3", "by_entropy": "", "by_coupling": "6n",
}  # fmt: skip


def rollouts_of(robot: str, rng: np.random.Generator, momentum: bool = False) -> tuple[RateSpline, Rollouts]:
    """Return a spline and motions of an arm with initial joint rates, optionally with momentum."""
    sms = ffsms.load(robot)
    limits = sms.limits
    middle = 0.5 * (np.maximum(limits.lower, -1.0) + np.minimum(limits.upper, 1.0))
    change: dict[str, Any] = {"momentum": [0.2, -0.1, 0.0, 0.0, 0.0, 0.3]} if momentum else {}
    if momentum and sms.n > 3:
        change["momentum"] = [0.2, -0.1, 0.3, 0.3, -0.2, 0.4]
    problem = opt.Problem(
        sms,
        sms.configuration(middle),
        goal=np.array([0.7, 0.5, 0.0]),
        duration=6.0,
        dt=0.02,
        joint_rates=0.02 * rng.normal(size=sms.n),
        **change,
    )
    spline = spline_of(problem, TINY, free_end=True)
    return spline, motions(problem, spline, 0.2 * rng.normal(size=(MOTIONS, spline.size, sms.n)))


def plain_rows(spline: RateSpline, at: Rollouts, residual: opt.Variable, s: int) -> tuple[FloatArray, Any]:
    """Return rows (V, M n) of the values of motion `s`, and the indices of these values."""
    n, M, stack, arm = at.stack.n, spline.size, at.stack, at.arm
    spin_q, jstar_q = velocity_slopes(stack, arm, at.rates, at.angular_drift)
    tip_spin_q = spin_q + tip_turning_slopes(stack, arm, at.rates)
    entropy_q = coupling_slopes(stack, arm, at.entropy_and_slope[1])
    maps = [
        np.einsum("km,ij->kimj", rate_map.free, np.eye(n)).reshape(-1, n, M * n)
        for rate_map in (spline.travel, spline.rates, spline.accelerations)
    ]
    # Derivatives of q, u and the acceleration by p at each instant (K, n, Mn), then `turn` (K, 3, Mn).
    dq, du, da = maps
    R = at.base_attitude[:, :, s].transpose(2, 0, 1)

    def of_motion(values: FloatArray) -> FloatArray:
        """Return the values of motion `s`, instants first: (K, 3, n)."""
        return np.moveaxis(values[..., s, :], -1, 0)

    spin, spin_slope = of_motion(arm.spin), of_motion(spin_q)
    d_omega = R @ (spin @ du + spin_slope @ dq)
    # A turn changes the drift of the spin, in base axes by J (h x R^T turn).
    momentum = np.zeros(3) if at.angular_momentum is None else at.angular_momentum
    h, inverse = np.swapaxes(R, 1, 2) @ momentum, of_motion(arm.inverse)
    turn = integrated(spline, d_omega)
    for _ in range(60 if momentum.any() else 0):
        own_turn = inverse @ np.cross(h[:, :, None], np.swapaxes(R, 1, 2) @ turn, axis=1)
        turn = integrated(spline, d_omega + R @ own_turn)
    own_turn = inverse @ np.cross(h[:, :, None], np.swapaxes(R, 1, 2) @ turn, axis=1)
    rho, com = of_motion(arm.tip - arm.com), of_motion(arm.com)
    jstar, moves = of_motion(arm.jstar), of_motion(arm.axes) * stack.moves_tip

    def change_by_turn(lever: FloatArray) -> FloatArray:
        """Return the change of a vector in base axes (K, 3) due to the turn: turn x (R lever)."""
        return -np.cross((R @ lever[:, :, None]), turn, axis=1)

    u = of_motion(at.rates)[:, :, None]
    own = of_motion(at.angular_drift)
    velocity = (jstar @ u)[..., 0] + np.cross(own, rho)
    base_spin = (spin @ u)[..., 0] + own
    tip_spin = base_spin + (moves @ u)[..., 0]
    # J* includes the rotation by the spin, which is added separately as `turn`.
    d_rho = jstar - np.cross(spin, rho[:, :, None], axis=1)
    by = {
        "by_joints": dq,
        "by_rates": du,
        "by_accelerations": da,
        "by_tip": R @ d_rho @ dq + change_by_turn(rho),
        "by_velocity": R
        @ (jstar @ du + of_motion(jstar_q) @ dq - np.cross(rho[:, :, None], own_turn, axis=1))
        + change_by_turn(velocity),
        "by_turn": R @ moves @ dq + turn,
        "by_spin": R @ ((spin + moves) @ du + of_motion(tip_spin_q) @ dq + own_turn)
        + change_by_turn(tip_spin),
        "by_base": -R @ of_motion(arm.linear) @ dq / stack.mass + change_by_turn(stack.base_com - com),
        "by_base_turn": turn,
        "by_base_spin": R @ (spin @ du + spin_slope @ dq + own_turn) + change_by_turn(base_spin),
        "by_entropy": of_motion(entropy_q)[:, None] @ dq,
    }
    rows = []
    motion, chosen = residual.where or (None, slice(None))
    instants = np.arange(len(at.times))[chosen]
    selected = np.arange(len(instants)) if motion is None else np.flatnonzero(motion == s)
    for i in selected:
        k, row = instants[i], np.zeros(M * n)
        for name, slope in residual.slopes.items():
            here = slope[..., 0 if motion is not None else s, i]
            if name == "by_coupling":
                full = np.zeros((*arm.coupling.shape[:-2], MOTIONS, len(at.times)))
                full[..., s, k] = here
                row += coupling_slopes(stack, arm, full)[:, s, k] @ dq[k]
            else:
                row += np.atleast_1d(here) @ by[name][k]
        rows.append(row)
    return np.array(rows).reshape(len(rows), M * n), selected


def plain_sums(
    spline: RateSpline, at: Rollouts, chosen: FloatArray, residuals: list[WeightedResidual]
) -> tuple[FloatArray, FloatArray]:
    """Return J^T W r and J^T W J, row by row."""
    size = spline.size * at.stack.n
    gradient, hessian = np.zeros((len(chosen), size)), np.zeros((len(chosen), size, size))
    for t, s in enumerate(chosen):
        for residual, weight in residuals:
            if residual.ndim == 3:
                rows, values, weights = plain_joints(spline, at, residual, weight, s)
            else:
                rows, selected = plain_rows(spline, at, residual, s)
                entries = residual.where is not None and residual.where[0] is not None
                values, weights = residual.value[0 if entries else s, selected], weight[selected]
            gradient[t] += rows.T @ (weights * values)
            hessian[t] += rows.T @ (weights[:, None] * rows)
    return gradient, hessian


def plain_joints(
    spline: RateSpline, at: Rollouts, residual: opt.Variable, weight: FloatArray, s: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rows (n K, M n), values and weights of a residual of single joints."""
    n, instants = at.stack.n, len(at.times)
    rows = np.zeros((n, instants, spline.size, n))
    parts = (
        (residual.slopes.get("own_joint"), spline.travel.free),
        (residual.slopes.get("own_rate"), spline.rates.free),
        (residual.slopes.get("own_acceleration"), spline.accelerations.free),
    )
    for slope, free in parts:
        if slope is not None:
            here = np.broadcast_to(slope, residual.value.shape)[:, s]
            for j in range(n):
                rows[j, :, :, j] += here[j, :, None] * free
    return rows.reshape(n * instants, -1), residual.value[:, s].ravel(), np.tile(weight, n)


def with_slopes(value: Any, instants: Any = slice(None), motion: Any = None, **slopes: Any) -> opt.Variable:
    """Return a variable of all motions at these instants, or, with `motion`, of V entries."""
    if motion is not None:
        value, slopes = value[None], {name: slope[..., None, :] for name, slope in slopes.items()}
    return opt.Variable(value, slopes, (motion, instants))


def random_residual(names: list[str], at: Rollouts, kind: str, rng: np.random.Generator) -> WeightedResidual:
    """Return a residual with random slopes at all instants, at some instants, or by entries."""
    n, count = at.stack.n, len(at.times)
    instants: Any = slice(None)
    shape: tuple[int, ...] = (MOTIONS, count)
    motion = None
    if kind == "some":
        instants = np.array([count - 1, 3, count - 2])
        shape = (MOTIONS, 3)
    elif kind == "entries":
        shape = (40,)
        motion, instants = rng.integers(0, MOTIONS, 40), rng.integers(0, count, 40)
    sizes = {"": (), "n": (n,), "3": (3,), "6n": (6, n)}
    slopes: dict[str, Any] = {name: rng.normal(size=(*sizes[SHAPES[name]], *shape)) for name in names}
    residual = with_slopes(rng.normal(size=shape), instants, motion, **slopes)
    return (residual, rng.uniform(0.1, 1.0, shape[-1]))


def weighted(residuals: list[WeightedResidual]) -> list[Weighted]:
    """Return the residuals as weighted residuals of the merit."""
    return [Weighted(residual, weight) for residual, weight in residuals]


def check_sums(spline: RateSpline, at: Rollouts, chosen: Any, residuals: list[WeightedResidual]) -> None:
    """Check the kernel's sums against plain sums, to 1e-9 of the largest entry."""
    chosen = np.asarray(chosen)
    sums = gradients_and_hessians(spline, at, chosen, weighted(residuals))
    for every, plain in zip(sums, plain_sums(spline, at, chosen, residuals), strict=True):
        chosen_sums = every[chosen]
        assert not np.delete(every, chosen, axis=0).any()
        np.testing.assert_allclose(chosen_sums, plain, rtol=0.0, atol=1e-9 * np.abs(plain).max())
        assert np.abs(plain).max() > 0.0


@pytest.mark.parametrize("momentum", [False, True])
@pytest.mark.parametrize("robot", ROBOTS)
def test_sums_with_each_slope_dense_and_by_entries(
    robot: str, momentum: bool, rng: np.random.Generator
) -> None:
    spline, at = rollouts_of(robot, rng, momentum)
    for name in SHAPES:
        for kind in ("all", "some", "entries"):
            check_sums(spline, at, [0, 1, 2], [random_residual([name], at, kind, rng)])


@pytest.mark.parametrize("robot", ROBOTS)
def test_sums_with_all_slopes_for_chosen_motions(robot: str, rng: np.random.Generator) -> None:
    """Include residuals of single joints, and leave out some motions."""
    spline, at = rollouts_of(robot, rng)
    n, count = at.stack.n, len(at.times)
    residuals = [random_residual(list(SHAPES), at, kind, rng) for kind in ("all", "some", "entries")]
    value = rng.normal(size=(n, MOTIONS, count))
    slopes = [rng.normal(size=shape) for shape in (value.shape, (n, 1, 1), (n, 1, count))]
    weight = rng.uniform(size=count)
    own = dict(zip(("own_joint", "own_rate", "own_acceleration"), slopes, strict=True))
    residuals.append((opt.Variable(value, own), weight))
    residuals.append((opt.Variable(value, {"own_rate": slopes[0]}), weight))
    check_sums(spline, at, [0, 1, 2], residuals)
    check_sums(spline, at, [2, 0], residuals)


def test_sums_with_strided_slopes(rng: np.random.Generator) -> None:
    """The slopes are views: transposed, broadcast or with a stride."""
    spline, at = rollouts_of("planar_3r", rng)
    count = len(at.times)
    value = np.broadcast_to(rng.normal(size=(MOTIONS, 1)), (MOTIONS, count))
    by_tip = rng.normal(size=(count, 2 * MOTIONS, 3)).transpose(2, 1, 0)[:, ::2]
    by_rates = np.broadcast_to(rng.normal(size=(3, 1, 1)), (3, MOTIONS, count))
    residual = with_slopes(value, by_tip=by_tip, by_rates=by_rates)
    check_sums(spline, at, [0, 1, 2], [(residual, np.ones(count))])


def test_sums_without_entries_are_zero(rng: np.random.Generator) -> None:
    spline, at = rollouts_of("planar_3r", rng)
    none = np.empty(0, dtype=np.int64)
    empty = with_slopes(np.empty(0), none, none, by_base=np.empty((3, 0)))
    gradient, hessian = gradients_and_hessians(spline, at, np.array([1]), weighted([(empty, np.empty(0))]))
    assert gradient.shape == (MOTIONS, spline.size * 3)
    assert not gradient.any()
    assert not hessian.any()
