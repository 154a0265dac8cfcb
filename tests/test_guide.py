"""Guides: slopes of the rolled-out motion, clearances that they keep, and the least squares behind them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.optimize import lsq_linear

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.guide import Guide, find_guide, followed_on
from ffsms_pin.opt.guide_roll import roll
from ffsms_pin.opt.guide_spline import basis
from ffsms_pin.opt.least_squares import least_squares
from ffsms_pin.system.base_motion import roll_out

Array = NDArray[np.float64]


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_slopes_are_difference_quotients(name: str, rng: np.random.Generator) -> None:
    sms, h = ffsms.load(name), 1e-5
    q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))
    path = q[7:] + 0.2 * np.cumsum(rng.normal(size=(6, sms.n)), axis=0)
    arrays = [path, 0.3 * rng.normal(size=path.shape), path[-1]]
    slopes = roll(sms, q, arrays[0], arrays[1], arrays[2], 6.0, slopes=True).slopes
    assert slopes is not None
    for k in (0, 3, 5):
        for j in range(sms.n):
            for which, slope in enumerate((slopes.positions[k], slopes.rates[k], slopes.last)):
                ends = []
                for step in (-h, h):
                    moved = [array.copy() for array in arrays]
                    (moved[which] if which == 2 else moved[which][k])[j] += step
                    ends.append(roll(sms, q, moved[0], moved[1], moved[2], 6.0))
                linear = (ends[1].position - ends[0].position) / (2.0 * h)
                turn = pin.log3(ends[1].rotation @ ends[0].rotation.T) / (2.0 * h)
                np.testing.assert_allclose(slope[:, j], np.concatenate([linear, turn]), atol=1e-8)


def test_roll_with_momentum_is_the_coasting_system(planar: ffsms.SpaceManipulator) -> None:
    # Joints at rest: the system turns as one body, about the plane's normal at a constant rate.
    q = planar.configuration([0.4, -0.3, 0.5])
    momentum = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.8])
    spin = planar.velocity(q, np.zeros(3), momentum)[5]
    end = roll(planar, q, np.tile(q[7:], (40, 1)), np.zeros((40, 3)), q[7:], 5.0, momentum)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, 5.0 * spin)
    start = planar.at(q).end_effector_pose
    assert 5.0 * spin > 0.1
    np.testing.assert_allclose(end.rotation, turn @ start.rotation, atol=1e-9)
    np.testing.assert_allclose(end.position, turn @ start.translation, atol=1e-9)


@pytest.mark.parametrize("count", [7, 10])
def test_basis_is_scipys(count: int) -> None:
    knots = np.concatenate([np.zeros(4), np.arange(1.0, count - 3) / (count - 3), np.ones(4)])
    spline, at = BSpline(knots, np.eye(count), 3), np.linspace(0.0, 1.0, 33)
    for order in (0, 1, 2):
        wanted = spline(at) if order == 0 else spline.derivative(order)(at)
        np.testing.assert_allclose(basis(count, order, at), wanted, atol=1e-12)


@pytest.mark.parametrize("count", [7, 10])
def test_one_instant_of_a_guide_is_as_many(count: int, rng: np.random.Generator) -> None:
    guide = Guide(2.0, 5.0, rng.normal(size=(count, 3)), 0.0, True)
    t = np.linspace(1.0, 8.0, 57)
    positions, rates = guide.along(t)
    for k, instant in enumerate(t):
        one = guide.sample(float(instant))
        np.testing.assert_allclose(one[0], positions[k], atol=1e-12)
        np.testing.assert_allclose(one[1], rates[k], atol=1e-12)


def nearest(sms: ffsms.SpaceManipulator, planner: opt.StepPlanner, q: Array, guide: Guide) -> float:
    """The least clearance along a guide."""
    assert planner.clearances is not None
    least = np.inf
    for t in np.linspace(guide.start, guide.start + guide.duration, 400):
        q_t = q.copy()
        sms.layout.set_positions(q_t, guide.sample(float(t))[0])
        least = min(least, float(planner.clearances.evaluate(q_t).value.min()))
    return least


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((0.2, 2.0, 2.3), (-1.1, -0.6, -2.3)),
        ((-0.8, 1.4, 2.2), (0.1, -2.5, -2.2)),
        ((0.0, -2.3, -2.5), (0.4, -2.1, -0.4)),
    ],
)
def test_guide_bends_round_what_it_would_hit(
    start: tuple[float, ...], end: tuple[float, ...], planar: ffsms.SpaceManipulator
) -> None:
    planner, q, still = opt.StepPlanner(planar), planar.configuration(start), np.zeros(3)
    way = np.linspace(start, end, 30)
    q_end, _ = roll_out(planar, q, np.subtract(end, start), np.zeros((30, 3)), 1.0 / 30.0)
    target = planar.at(q_end[-1]).end_effector_pose.translation
    free = find_guide(planar, q, still, target, 0.0, 40.0, way)
    assert nearest(planar, planner, q, free) < 0.0
    assert free.fits  # nobody asked for clearances
    kept = find_guide(planar, q, still, target, 0.0, 40.0, way, clearances=planner.clearances, clearance=0.01)
    assert kept.fits
    assert kept.miss < 5e-4
    assert nearest(planar, planner, q, kept) > 0.01 - 1e-3


def test_guide_that_cannot_bend_is_rejected(planar: ffsms.SpaceManipulator) -> None:
    # A target inside the base's box.
    planner, q = opt.StepPlanner(planar), planar.configuration([0.3, -1.6, 0.0])
    target = planar.at(q).base_pose.translation + np.array([0.1, 0.0, 0.0])
    way = np.tile(q[7:], (10, 1))
    assert find_guide(planar, q, np.zeros(3), target, 0.0, 40.0, way).fits
    kept = find_guide(
        planar, q, np.zeros(3), target, 0.0, 40.0, way, clearances=planner.clearances, clearance=0.01
    )
    assert not kept.fits or kept.miss > 0.05


def test_guide_found_again_from_itself_stays(rng: np.random.Generator) -> None:
    # Brought up to date over and over, it must not wander off: on the way nothing happens that it did not
    # foresee.
    sms = ffsms.load("satellite_panda")
    middle = 0.5 * (sms.limits.lower + sms.limits.upper)
    q = sms.configuration(middle)
    target = sms.at(q).end_effector_pose.translation + np.array([-0.15, 0.35, -0.25])
    guide = find_guide(sms, q, np.zeros(7), target, 0.0, 12.0, np.tile(middle, (10, 1)))
    assert guide.fits
    assert guide.miss < 5e-4
    t, farthest, fastest = 0.0, np.abs(guide.points - middle).max(), 0.0
    for _ in range(8):
        span = np.linspace(t, t + 1.0, 101)
        rates = np.array([guide.sample(float(s))[1] for s in span])
        ahead = np.array([guide.sample(float(s))[1] for s in np.linspace(t, 12.0, 100)])
        fastest = fastest or np.abs(ahead).max()
        assert np.abs(ahead).max() < 1.1 * fastest
        path, _ = roll_out(sms, q, rates[0], np.diff(rates, axis=0) / 0.01, 0.01)
        q, t = path[-1], t + 1.0
        ahead = np.array([guide.sample(float(s))[0] for s in np.linspace(t, 12.0, 30)])
        guide = find_guide(sms, q, rates[-1], target, t, 12.0 - t, ahead)
        assert guide.fits
        assert guide.miss < 5e-4
        assert np.abs(guide.points - middle).max() < 1.1 * farthest


def test_guide_keeps_the_box_of_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    # A quick motion of several joints: each within its rate limit, and yet |alpha_i| <= 1 would be broken.
    sms = ffsms.load("satellite_panda")
    start = 0.5 * (sms.limits.lower + sms.limits.upper)
    end = start + np.array([0.9, -0.8, 0.9, 0.7, 0.9, 0.6, 0.9])
    q = sms.configuration(start)
    q_end, _ = roll_out(sms, q, end - start, np.zeros((50, 7)), 0.02)
    target = sms.at(q_end[-1]).end_effector_pose.translation

    def largest(guide: Guide) -> float:
        """The largest |alpha_i| on the way."""
        found = 0.0
        for s in np.linspace(0.0, guide.duration, 60):
            positions, rates = guide.sample(float(s))
            V_T = np.linalg.svd(sms.at(sms.configuration(positions)).C_bm)[2]
            found = max(found, float(np.abs(V_T @ rates).max()))
        return found

    arguments = (sms, q, np.zeros(7), target, 0.0, 1.7, np.linspace(start, end, 20))
    kept = find_guide(*arguments)
    assert kept.fits
    assert kept.miss < 5e-4
    assert largest(kept) < 1.03
    monkeypatch.setattr("ffsms_pin.opt.guide._BOX", np.inf)
    free = find_guide(*arguments)
    assert largest(free) > 1.05


def test_guide_that_cannot_keep_the_box_is_rejected() -> None:
    sms = ffsms.load("satellite_panda")
    start = 0.5 * (sms.limits.lower + sms.limits.upper)
    end = start + np.array([0.9, -0.8, 0.9, 0.7, 0.9, 0.6, 0.9])
    q = sms.configuration(start)
    q_end, _ = roll_out(sms, q, end - start, np.zeros((50, 7)), 0.02)
    target = sms.at(q_end[-1]).end_effector_pose.translation
    hasty = find_guide(sms, q, np.zeros(7), target, 0.0, 0.6, np.linspace(start, end, 20))
    assert not hasty.fits or hasty.miss > 0.05


def test_bounded_least_squares_is_scipys(rng: np.random.Generator) -> None:
    for _ in range(20):
        A, b = rng.normal(size=(12, 5)), rng.normal(size=12)
        lower, upper = -rng.uniform(0.02, 0.5, 5), rng.uniform(0.02, 0.5, 5)

        def residuals(x: Array, A: Array = A, b: Array = b) -> tuple[Array, Array]:
            return A @ x - b, A

        x = least_squares(residuals, np.zeros(5), lower, upper, 60)
        wanted = lsq_linear(A, b, (lower, upper), method="bvls").x
        assert (x >= lower).all()
        assert (x <= upper).all()
        assert np.linalg.norm(A @ x - b) <= 1.001 * np.linalg.norm(A @ wanted - b)
        np.testing.assert_allclose(x, wanted, atol=2e-2)


def test_least_squares_finds_a_curved_valley() -> None:
    def rosenbrock(x: Array) -> tuple[Array, Array]:
        slopes = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), slopes

    x = least_squares(rosenbrock, np.array([-1.2, 1.0]), np.full(2, -5.0), np.full(2, 5.0), 200)
    np.testing.assert_allclose(x, 1.0, atol=1e-4)


def test_least_squares_stops_where_little_is_left_to_gain() -> None:
    called = []

    def parabola(x: Array) -> tuple[Array, Array]:
        called.append(x.copy())
        return np.array([x[0] ** 2 + 0.1]), np.array([[2.0 * x[0]]])

    calls = []
    for enough in (0.0, 1e-3):
        called.clear()
        x = least_squares(parabola, np.ones(1), np.full(1, -5.0), np.full(1, 5.0), 100, enough)
        assert (x[0] ** 2 + 0.1) ** 2 - 0.01 < (1e-2 if enough else 1e-4)
        calls.append(len(called))
    assert calls[1] < calls[0]


def test_guide_followed_on_ends_where_it_was_to_end(planar: ffsms.SpaceManipulator) -> None:
    start, end = np.array([0.3, 0.4, -0.2]), np.array([0.9, -0.6, 0.5])
    q = planar.configuration(start)
    q_end, _ = roll_out(planar, q, end - start, np.zeros((30, 3)), 1.0 / 30.0)
    target = planar.at(q_end[-1]).end_effector_pose.translation
    guide = find_guide(planar, q, np.zeros(3), target, 0.0, 12.0, np.linspace(start, end, 30))
    assert guide.miss < 1e-3
    # Along it by another code: foreseen from five seconds on is where it really ends.
    t = np.linspace(0.0, 12.0, 1201)
    rates = np.array([guide.sample(float(s))[1] for s in t])
    path, _ = roll_out(planar, q, rates[0], np.diff(rates, axis=0) / 0.01, 0.01)
    really = np.linalg.norm(planar.at(path[-1]).end_effector_pose.translation - target)
    again = followed_on(guide, planar, path[500], 5.0, target, None)
    assert again.miss == pytest.approx(really, abs=1e-4)
    assert guide.miss == pytest.approx(really, abs=1e-3)  # its own samples are further apart
    np.testing.assert_array_equal(again.points, guide.points)
    other = followed_on(guide, planar, path[500], 5.0, target + 0.1, None)
    assert other.miss == pytest.approx(0.1 * np.sqrt(3.0), abs=2e-3)
