"""Guides under limits on the base's motion: kept, or rejected, alone and in the loop."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt import guide_search
from ffsms_pin.opt.guide import Guide, find_guide
from ffsms_pin.opt.guide_base import BaseResiduals
from ffsms_pin.opt.guide_problem import GuideProblem
from ffsms_pin.opt.guide_unknowns import Unknowns
from ffsms_pin.opt.targets import Goal
from ffsms_pin.simulation import random_plants, simulate
from ffsms_pin.system.base_motion import roll_out

Array = NDArray[np.float64]

DEGREE = np.pi / 180.0
WAY = np.array([-0.15, 0.35, -0.25])  # half a metre, as in benchmarks/robustness.py


@pytest.fixture(scope="module")
def panda() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


@pytest.fixture(scope="module")
def middle(panda: ffsms.SpaceManipulator) -> Array:
    return np.asarray(0.5 * (panda.limits.lower + panda.limits.upper))


@pytest.fixture(scope="module")
def start(panda: ffsms.SpaceManipulator, middle: Array) -> Array:
    # Turned and shifted: the limits count from where the base starts.
    return panda.configuration(
        middle, pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    )


def finely(sms: ffsms.SpaceManipulator, guide: Guide, q: Array, first: Array) -> dict[str, float]:
    """The largest of what a limit is on along a guide, by another code and finer steps."""
    dt = guide.duration / 600.0
    rates = guide.sample(np.linspace(guide.start, guide.start + guide.duration, 601))[1]
    path, speeds = roll_out(sms, q, rates[0], np.diff(rates, axis=0) / dt, dt)
    states = [sms.at(row, sms.velocity(row, rate)) for row, rate in zip(path, speeds, strict=True)]
    poses, origin = [state.base_pose for state in states], sms.at(first).base_pose
    turns = [float(np.linalg.norm(pin.log3(origin.rotation.T @ pose.rotation))) for pose in poses]
    return {
        "attitude": max(turns),
        "attitude_rate": max(float(np.linalg.norm(state.base_twist[3:])) for state in states),
        "translation": max(float(np.linalg.norm(pose.translation - origin.translation)) for pose in poses),
        "final_attitude": turns[-1],
    }


@pytest.mark.parametrize(
    ("name", "share", "possible"),
    [
        ("attitude", 0.5, True),
        ("attitude_rate", 0.5, True),
        ("final_attitude", 0.5, True),
        ("translation", 0.7, True),
        ("translation", 0.3, False),  # the common centre of mass stays, so the base has to give way
    ],
)
def test_guide_keeps_the_limit_or_is_rejected(
    name: str, share: float, possible: bool, panda: ffsms.SpaceManipulator, start: Array, middle: Array
) -> None:
    target = panda.at(start).end_effector_pose.translation
    target = target + pin.XYZQUATToSE3(start[:7]).rotation @ WAY
    find = partial(find_guide, panda, start, np.zeros(7), target, 0.0, 12.0, np.tile(middle, (10, 1)))
    free = find()
    limit = share * finely(panda, free, start, start)[name]
    held = find(base_limits=opt.BaseLimits(**{name: limit}))
    assert free.fits
    assert free.miss < 5e-4
    assert held.fits == possible
    if possible:
        assert held.miss < 5e-4
        assert 0.5 * limit < finely(panda, held, start, start)[name] <= 0.99 * limit


def test_limits_count_from_where_the_base_started(
    panda: ffsms.SpaceManipulator, start: Array, middle: Array
) -> None:
    """Half the turn is used up already."""
    limits, before = opt.BaseLimits(attitude=5.0 * DEGREE), start.copy()
    before[:7] = pin.SE3ToXYZQUAT(
        pin.XYZQUATToSE3(start[:7]) * pin.SE3(pin.exp3(np.array([0.0, 0.0, -2.0 * DEGREE])), np.zeros(3))
    )
    target = panda.at(start).end_effector_pose.translation + pin.XYZQUATToSE3(start[:7]).rotation @ WAY
    turns = {}
    for first in (start, before):
        guide = find_guide(
            panda,
            start,
            np.zeros(7),
            target,
            0.0,
            6.0,
            np.tile(middle, (10, 1)),
            base_limits=limits,
            base_start=first[:7],
        )
        assert guide.fits
        assert guide.miss < 5e-4
        turns[first is before] = [finely(panda, guide, start, one)["attitude"] for one in (start, before)]
    assert turns[True][1] <= limits.attitude
    assert turns[False][0] <= limits.attitude < turns[False][1]


@pytest.mark.parametrize("name", ["attitude", "attitude_rate", "translation", "final_attitude"])
@pytest.mark.parametrize("robot", ["planar_3r", "satellite_panda"])
def test_slopes_of_the_squares_are_difference_quotients(
    robot: str, name: str, rng: np.random.Generator
) -> None:
    sms, h = ffsms.load(robot), 1e-6
    n = sms.n
    q, rates, fixed = sms.configuration(rng.uniform(-0.8, 0.8, n)), 0.05 * np.ones(n), np.zeros(n, dtype=bool)
    fixed[1] = True
    unknowns = Unknowns(sms.layout.positions(q), rates, 5.0, fixed)
    base = BaseResiduals(opt.BaseLimits(**{name: 1e-3}), q[:7], sms.base_com, 5.0)
    goal = Goal(sms.at(q).end_effector_pose.translation)
    x = unknowns.nearest(q[7:] + np.linspace(0.0, 1.0, 12)[:, None] * rng.normal(size=n))

    def squares(x: Array, with_base: bool = True) -> tuple[float, Array]:
        problem = GuideProblem(sms, q, goal, 5.0, unknowns, None, base if with_base else None, None)
        value, slope = problem.residuals(x)
        return float(value @ value), 2.0 * slope.T @ value

    assert squares(x)[0] > squares(x, with_base=False)[0] + 1.0
    for _ in range(3):
        step = h * rng.normal(size=x.size)
        change = 0.5 * (squares(x + step)[0] - squares(x - step)[0])
        assert float(squares(x)[1] @ step) == pytest.approx(change, rel=1e-5)


def test_replanning_finds_a_way_within_the_limit_that_blind_guides_do_not(
    panda: ffsms.SpaceManipulator, middle: Array, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a wrong plant. Steps that follow a blind guide keep the limit too, and so leave the guide."""
    q0, limit = panda.configuration(middle), 3.0 * DEGREE
    plant = list(random_plants(panda, np.random.default_rng(1), 10))[9]
    target = panda.at(q0).end_effector_pose.translation + WAY
    first = pin.XYZQUATToSE3(q0[:7]).rotation.T

    def run() -> tuple[float, float]:
        planner = opt.StepPlanner(panda, dt=0.02, base_limits=opt.BaseLimits(attitude=limit))
        law = ComputedTorque(panda, 100.0, 20.0)
        tracking = simulate(panda, planner.track(target, 12.0), law, dt=2e-3, q0=q0, plant=plant)
        turns = [pin.log3(first @ pin.XYZQUATToSE3(q[:7]).rotation) for q in tracking.q[::10]]
        return float(np.linalg.norm(turns, axis=1).max()), float(tracking.position_error[-1])

    turn, miss = run()
    assert miss < 5e-3
    assert 0.5 * limit < turn <= limit

    def blind(*arguments: Any, **given: Any) -> Guide:
        return find_guide(*arguments, **{**given, "base_limits": None})

    monkeypatch.setattr(guide_search, "find_guide", blind)
    turn, miss = run()
    assert miss > 0.05
    assert turn <= limit
