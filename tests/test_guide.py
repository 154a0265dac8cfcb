"""Guides: slopes of the rolled-out motion, the splines, and the limits and clearances that they keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.guide import Guide, find_guide, followed_on
from ffsms_pin.opt.guide_roll import roll
from ffsms_pin.opt.guide_spline import NODES, basis, maps
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
def test_maps_are_those_of_the_recursion(count: int) -> None:
    """Cox and de Boor's, written out; derivatives as differences."""
    knots = np.concatenate([np.zeros(4), np.arange(1.0, count - 3) / (count - 3), np.ones(4)])

    def value(i: int, degree: int, s: float) -> float:
        if degree == 0:
            return float(knots[i] <= s < knots[i + 1])
        left, right = knots[i + degree] - knots[i], knots[i + degree + 1] - knots[i + 1]
        first = (s - knots[i]) / left * value(i, degree - 1, s) if left > 0.0 else 0.0
        last = (knots[i + degree + 1] - s) / right * value(i + 1, degree - 1, s) if right > 0.0 else 0.0
        return first + last

    made, h = maps(count), 1e-4
    for k, s in enumerate(NODES):
        below, here, above = (
            np.array([value(i, 3, place) for i in range(count)]) for place in (s - h, s, s + h)
        )
        np.testing.assert_allclose(made.positions[k], here, atol=1e-12)
        np.testing.assert_allclose(made.rates[k], (above - below) / (2.0 * h), atol=1e-4)
    # Straight lines between the knots give the accelerations; at rest at the end, whatever the last point.
    inner = np.linspace(0.0, 1.0, count - 2)
    between = basis(count, 2, 0.5 * (inner[1:] + inner[:-1]))
    np.testing.assert_allclose(between, 0.5 * (made.accelerations[1:] + made.accelerations[:-1]), atol=1e-9)
    np.testing.assert_allclose(basis(count, 1, np.ones(1)) @ made.free, 0.0, atol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        made.rates[0, 0] = 1.0


@pytest.mark.parametrize("count", [7, 10])
def test_one_instant_of_a_guide_is_as_many(count: int, rng: np.random.Generator) -> None:
    guide = Guide(2.0, 5.0, rng.normal(size=(count, 3)), 0.0, True)
    t = np.linspace(1.0, 8.0, 57)
    positions, rates = guide.sample(t)
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


def panda_swing() -> tuple[ffsms.SpaceManipulator, Array, Array, Array]:
    """An arm, where a move of all its joints starts and ends, and where that takes the end effector."""
    sms = ffsms.load("satellite_panda")
    start = 0.5 * (sms.limits.lower + sms.limits.upper)
    end = start + np.array([0.9, -0.8, 0.9, 0.7, 0.9, 0.6, 0.9])
    q, _ = roll_out(sms, sms.configuration(start), end - start, np.zeros((50, 7)), 0.02)
    return sms, start, end, sms.at(q[-1]).end_effector_pose.translation


def test_guide_keeps_the_box_of_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    # A quick motion of several joints: each within its rate limit, and yet |alpha_i| <= 1 would be broken.
    sms, start, end, target = panda_swing()
    q = sms.configuration(start)

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
    monkeypatch.setattr("ffsms_pin.opt.guide_limits._BOX", np.inf)
    free = find_guide(*arguments)
    assert largest(free) > 1.05


@pytest.mark.parametrize(("duration", "fits"), [(1.6, True), (1.5, False)])
def test_guide_keeps_the_accelerations_or_is_rejected(duration: float, fits: bool) -> None:
    sms, start, end, target = panda_swing()
    q = sms.configuration(start)
    guide = find_guide(sms, q, np.zeros(7), target, 0.0, duration, np.linspace(start, end, 20))
    t = np.linspace(0.0, duration, 2001)
    rates = guide.sample(t)[1]
    accelerations = np.diff(rates, axis=0) / np.diff(t)[:, None]
    used = float((np.abs(accelerations) / sms.limits.acceleration).max())
    # In less time it can only be had with more acceleration; the rates and the box alone do not show it.
    assert (np.abs(rates) < 1.02 * sms.limits.velocity).all()
    V_T = [np.linalg.svd(sms.at(sms.configuration(row)).C_bm)[2] for row in guide.sample(NODES * duration)[0]]
    alphas = np.einsum("kij,kj->ki", V_T, guide.sample(NODES * duration)[1])
    assert np.abs(alphas).max() < 1.02
    assert guide.fits == fits
    assert (used < 0.97) if fits else (used > 1.05)


def test_guide_stays_within_the_range_of_the_joints(planar: ffsms.SpaceManipulator) -> None:
    """A target that the arm would reach beyond its range only."""
    narrow = planar.with_limits(replace(planar.limits, lower=np.full(3, -0.4), upper=np.full(3, 0.4)))
    q, end = planar.configuration([0.1, 0.2, 0.3]), planar.configuration([0.2, 0.9, 0.8])
    target, way = planar.at(end).end_effector_pose.translation, np.linspace(q[7:], end[7:], 20)
    free, kept = (find_guide(sms, q, np.zeros(3), target, 0.0, 12.0, way) for sms in (planar, narrow))
    t = np.linspace(0.0, 12.0, 200)
    assert free.miss < 1e-3
    assert np.abs(free.sample(t)[0]).max() > 0.5
    assert kept.miss > 0.05
    assert np.abs(kept.sample(t)[0]).max() < 0.4


def test_guide_of_an_arm_whose_joints_turn_without_end(planar: ffsms.SpaceManipulator) -> None:
    endless = replace(planar.limits, lower=np.array([-np.inf, -np.inf, -2.0]), upper=np.full(3, np.inf))
    sms, start, end = planar.with_limits(endless), np.array([3.0, 0.3, 0.2]), np.array([4.0, 0.9, 0.6])
    q = sms.configuration(start)
    q_end, _ = roll_out(sms, q, end - start, np.zeros((30, 3)), 1.0 / 30.0)
    target = sms.at(q_end[-1]).end_effector_pose.translation
    guide = find_guide(sms, q, np.zeros(3), target, 0.0, 12.0, np.linspace(start, end, 20))
    assert guide.fits
    assert guide.miss < 5e-4
    assert guide.points[-1, 0] > np.pi


def test_guide_of_an_arm_that_cannot_move(planar: ffsms.SpaceManipulator) -> None:
    q, target, failed = (
        planar.configuration([0.1, 0.2, 0.3]),
        np.array([0.7, 0.4, 0.0]),
        np.ones(3, dtype=bool),
    )
    guide = find_guide(planar, q, np.zeros(3), target, 0.0, 5.0, np.tile(q[7:], (10, 1)), fixed=failed)
    np.testing.assert_allclose(guide.sample(3.0)[0], q[7:], atol=1e-15)
    assert guide.miss == pytest.approx(np.linalg.norm(planar.at(q).end_effector_pose.translation - target))


def test_guide_that_cannot_keep_the_box_is_rejected() -> None:
    sms, start, end, target = panda_swing()
    q = sms.configuration(start)
    hasty = find_guide(sms, q, np.zeros(7), target, 0.0, 0.6, np.linspace(start, end, 20))
    assert not hasty.fits or hasty.miss > 0.05


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
