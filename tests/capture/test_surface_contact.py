"""Surface contacts compared with closed forms of Hertz, Hunt and Crossley, and Coulomb; conservation laws."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from two_bodies import Motion, TwoBodies

from ffsms_pin.capture.surface_contact import SurfaceContact, hertz_stiffness
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.convex_parts import hull_of

BALL, PLATE = coal.Sphere(0.1), coal.Box(1.0, 1.0, 1.0)
MASSES, INERTIAS = (2.0, 3.0), ([0.02, 0.02, 0.02], [0.2, 0.3, 0.25])
MEAN = 2.0 * 3.0 / 5.0  # mass of the relative motion [kg]
K = hertz_stiffness(0.1, 5e6, 0.3)


def _on_top(gap: float = 0.0) -> list[Any]:
    return [pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.6 + gap])), pin.SE3.Identity()]


def _impact(speed: float, dt: float, steps: int, **law: float) -> tuple[Motion, TwoBodies]:
    surface = SurfaceContact([BALL], [PLATE], **{"stiffness": K, "damping": 0.0, "friction": 0.0, **law})
    bodies = TwoBodies(MASSES, INERTIAS, [surface])
    return bodies.run(_on_top(), [[0.0, 0.0, -speed, 0.0, 0.0, 0.0], np.zeros(6)], dt, steps), bodies


def _restitution(motion: Motion, speed: float) -> float:
    return float(motion.v[-1, 2] - motion.v[-1, 8]) / speed


def test_hertz_stiffness_is_that_of_the_textbook() -> None:
    """Johnson, equation 4.23: the approach of two elastic spheres under a load P."""
    R, E, nu, P = 0.02, 70e9, 0.33, 100.0
    contact_modulus = 1.0 / (2.0 * (1.0 - nu**2) / E)
    approach = (9.0 * P**2 / (16.0 * R * contact_modulus**2)) ** (1.0 / 3.0)
    assert hertz_stiffness(R, E, nu) * approach**1.5 == pytest.approx(P, rel=1e-12)
    assert SurfaceContact.stiffness == pytest.approx(2.0 * hertz_stiffness(0.01, 5e6, 0.48), rel=0.01)


def test_a_ball_rests_at_the_depth_of_hertz() -> None:
    bodies = TwoBodies(
        (2.0, 1e6),
        ([0.02] * 3, [1e5] * 3),
        [SurfaceContact([BALL], [PLATE], K, damping=30.0)],
        [0, 0, -5, 0, 0, 0],
    )
    motion = bodies.run(_on_top(), np.zeros((2, 6)), 1e-3, 1500)
    poses, _ = bodies.states(motion.q[-1], motion.v[-1])
    depth = 0.6 - (poses[0].translation - poses[1].translation)[2]
    assert depth == pytest.approx((5.0 / K) ** (2.0 / 3.0), rel=1e-4)


def test_the_duration_and_peak_of_an_impact_are_those_of_hertz() -> None:
    """Johnson, 11.24 to 11.26: depth, force and duration of a collision of spheres."""
    speed = 0.05
    depth = (1.25 * MEAN * speed**2 / K) ** 0.4
    share = quad(lambda x: 2.0 / np.sqrt(1.0 - x**2.5), 0.0, 1.0)[0]  # 2.94
    time = share * depth / speed
    motion, _ = _impact(speed, time / 100, 110)
    assert motion.peak == pytest.approx(K * depth**1.5, rel=1e-3)
    touching = np.flatnonzero(motion.wrench[:, 2] > 0.0)
    assert touching.size * time / 100 == pytest.approx(time, rel=0.015)
    assert _restitution(motion, speed) == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("loss", [0.02, 0.2, 0.6])
def test_restitution_is_that_of_hunt_and_crossley(exponent: float, loss: float) -> None:
    """The integral x - log(1 + x), with x = 3/2 c v, is equal before and after the impact."""
    speed, depth = 0.04, 1e-3
    stiffness = 0.5 * (exponent + 1.0) * MEAN * speed**2 / depth ** (exponent + 1.0)
    law = {"exponent": exponent, "stiffness": stiffness, "damping": loss / speed}
    motion, _ = _impact(speed, 2e-4, 1000, **law)
    assert not motion.wrench[-1].any()
    restitution, x = _restitution(motion, speed), 1.5 * loss

    def area(x: float) -> float:
        return float(x - np.log1p(x))

    exact = brentq(lambda e: area(-e * x) - area(x), 0.0, min(1.0, (1.0 - 1e-12) / x))
    assert restitution == pytest.approx(exact, rel=1e-4)
    assert restitution == pytest.approx(1.0 - loss, abs=loss**2)


@pytest.mark.parametrize(("share", "slides"), [(0.5, False), (0.95, False), (1.5, True)])
def test_a_block_on_an_incline(share: float, slides: bool) -> None:
    """Below the largest friction the block creeps at s_0 atanh(share), above it slides."""
    mass, normal, mu, s_0 = 4.0, 20.0, 0.4, 1e-3
    feet = [
        (coal.Sphere(0.01), pin.SE3(np.eye(3), np.array([x, y, -0.09])))
        for x in (-0.1, 0.1)
        for y in (-0.1, 0.1)
    ]
    across = share * mu * normal
    surface = SurfaceContact(feet, [PLATE], 1e5, 1.0, 20.0, mu, s_0)
    bodies = TwoBodies(
        (mass, 1e8), ([0.04] * 3, [1e7] * 3), [surface], [across, 0.0, -normal, 0.0, -0.1 * across, 0.0]
    )
    depth = normal / 4.0 / 1e5
    start = [pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.6 - depth])), pin.SE3.Identity()]
    motion = bodies.run(start, np.zeros((2, 6)), 3e-4, 500)
    speed = motion.v[-1, 0]
    if slides:
        assert speed == pytest.approx((across - mu * normal) / mass * 0.15, rel=0.01)
    else:
        assert speed == pytest.approx(s_0 * np.arctanh(share), rel=0.01)


def test_only_friction_gives_a_tangential_impulse() -> None:
    twists = np.array([[0.05, 0.02, -0.05, 0.0, 0.0, 0.0], np.zeros(6)])
    for mu in (0.0, 0.3):
        bodies = TwoBodies(MASSES, INERTIAS, [SurfaceContact([BALL], [PLATE], K, friction=mu)])
        motion = bodies.run(_on_top(), twists, 2e-4, 400)
        impulse = MASSES[0] * (bodies.states(motion.q[-1], motion.v[-1])[1][0][:3] - twists[0][:3])
        # The impulse of friction is against the slip. Friction is at most mu times the normal force.
        assert not motion.wrench[-1].any()
        tangential = float(np.hypot(*impulse[:2]))
        if mu == 0.0:
            assert tangential < 1e-4 * impulse[2]  # the plate has turned a little
        else:
            assert 0.1 * impulse[2] < tangential < 1.001 * mu * impulse[2]
            assert impulse[:2] @ twists[0][:2] < 0.0


def _flying(seed: int, dissipative: bool) -> tuple[Any, list[Any], list[Any]]:
    """Return two irregular bodies of several shapes each, which collide while both turn."""
    rng = np.random.default_rng(seed)

    def placed(shape: Any, place: Any) -> Any:
        return shape, pin.SE3(pin.exp3(rng.normal(size=3)), np.array(place))

    rod = coal.Capsule(0.02, 0.3)
    tool = [placed(rod, [0.0, 0.0, 0.05]), placed(coal.Sphere(0.08), [0.05, 0.0, -0.1])]
    pieces = [
        placed(hull_of(0.15 * rng.normal(size=(10, 3))), [0.0, 0.1, 0.0]),
        placed(coal.Box(0.3, 0.2, 0.4), np.zeros(3)),
    ]
    surface = SurfaceContact(
        tool, pieces, 2e4, 1.0 + 0.5 * (seed % 2), 5.0 * dissipative, 0.4 * dissipative, 1e-3
    )
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    turns = [pin.exp3(rng.normal(size=3)) for _ in range(2)]
    poses, rest = [pin.SE3(turns[0], 0.8 * direction), pin.SE3(turns[1], np.zeros(3))], np.zeros(6)
    while not surface.touches(poses[0], rest, poses[1], rest):
        poses[0].translation = poses[0].translation - 0.01 * direction
    poses[0].translation = poses[0].translation + 0.02 * direction
    twists = [
        np.concatenate([-0.5 * direction, rng.normal(size=3)]),
        np.concatenate([0.1 * direction, rng.normal(size=3)]),
    ]
    return surface, poses, twists


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("dissipative", [True, False])
def test_momentum_is_kept_and_energy_never_grows(seed: int, dissipative: bool) -> None:
    """Without damping and friction the contact is elastic, so the energy is equal before and after."""
    surface, poses, twists = _flying(seed, dissipative)
    bodies = TwoBodies(MASSES, ([0.03, 0.05, 0.04], [0.1, 0.15, 0.12]), [surface])
    motion = bodies.run(poses, twists, 1e-4, 2000)
    assert not motion.wrench[[0, -1]].any()
    assert motion.peak > 1.0
    states = [(motion.q[k], motion.v[k]) for k in (0, -1)]
    before, after = (bodies.momentum(*state) for state in states)
    np.testing.assert_allclose(after, before, rtol=0.0, atol=1e-9)
    first, last = (bodies.energy(*state) for state in states)
    assert last < 0.99 * first if dissipative else last == pytest.approx(first, rel=1e-6)


def test_contact_points_are_those_of_the_shapes() -> None:
    surface = SurfaceContact(
        [BALL], [PLATE, (PLATE, pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])))], 1e4, 1.0, 0.0, 0.0
    )
    turn = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([1.0, 2.0, 3.0]))
    for depth in (-1e-3, 1e-9, 1e-3, 0.05):
        pose = pin.SE3(np.eye(3), np.array([0.2, 0.1, 0.6 - depth]))
        touches = surface.touches(turn * pose, np.zeros(6), turn, np.zeros(6))
        assert len(touches) == (depth > 0.0)
        for touch in touches:
            assert (touch.tool, touch.client) == (0, 0)
            assert touch.depth == pytest.approx(depth, abs=1e-12)
            np.testing.assert_allclose(touch.normal, turn.rotation[:, 2], atol=1e-7)
            np.testing.assert_allclose(turn.actInv(touch.point), [0.2, 0.1, 0.5 - 0.5 * depth], atol=1e-9)
            np.testing.assert_allclose(touch.force, 1e4 * depth * touch.normal, rtol=1e-3, atol=1e-9)


def test_concentric_shapes_have_a_finite_contact_force() -> None:
    for shape in (BALL, PLATE, coal.Capsule(0.05, 0.4), coal.Cylinder(0.1, 0.3)):
        for other in (BALL, PLATE, coal.Capsule(0.05, 0.4)):
            surface = SurfaceContact([shape], [other], 1e3, 1.0)
            (touch,) = surface.touches(pin.SE3.Identity(), np.zeros(6), pin.SE3.Identity(), np.zeros(6))
            assert np.isfinite(touch.force).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tool_shapes": []}, "tool_shapes must hold at least one shape"),
        ({"tool_shapes": [coal.Plane()]}, "tool_shapes must be a box"),
        ({"exponent": 0.5}, "exponent must lie between 1 and 10"),
        ({"friction": -0.1}, "friction must be at least zero"),
    ],
)
def test_bad_values_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        SurfaceContact(**{"tool_shapes": [BALL], "client_shapes": [PLATE], **values})
