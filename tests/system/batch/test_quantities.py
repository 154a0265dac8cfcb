"""Base motion, assistance and rank of stacks, against the plain formulas one configuration at a time."""

from __future__ import annotations

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.system.batch.batch import assistance, base_motion, generic_rank

ROBOTS = ["planar_3r", "satellite_ur5", "satellite_panda"]


@pytest.mark.parametrize("name", ROBOTS)
def test_base_motion_is_the_largest_that_a_metre_can_cost(name: str, rng: np.random.Generator) -> None:
    sms = ffsms.load(name)
    batch = sms.batch(rng.uniform(-2.0, 2.0, (30, sms.n)))
    J_v = batch.J_star[:, :3]
    found = base_motion(batch.C_bm.transpose(1, 2, 0), J_v.transpose(1, 2, 0))
    for k, C_bm in enumerate(batch.C_bm):
        X = C_bm @ np.linalg.pinv(J_v[k], rcond=1e-8)
        assert found.translation[k] == pytest.approx(np.linalg.norm(X[:3], 2), rel=1e-6)
        assert found.rotation[k] == pytest.approx(np.linalg.norm(X[3:], 2), rel=1e-6)
        # No motion of the end effector by the least rates moves the base more.
        rates = np.linalg.pinv(J_v[k], rcond=1e-8) @ rng.normal(size=(3, 50))
        metres = np.linalg.norm(J_v[k] @ rates, axis=0)
        assert (np.linalg.norm(C_bm[3:] @ rates, axis=0) <= found.rotation[k] * metres * (1.0 + 1e-6)).all()


def test_a_heavy_base_hardly_moves(rng: np.random.Generator) -> None:
    from ffsms_pin.atlas.designs import with_base_mass

    sms = ffsms.load("satellite_panda")
    joints = rng.uniform(-2.0, 2.0, (50, 7))

    def rotation(robot: ffsms.SpaceManipulator) -> float:
        batch = robot.batch(joints)
        C_bm, J_v = batch.C_bm.transpose(1, 2, 0), batch.J_star[:, :3].transpose(1, 2, 0)
        return float(np.median(base_motion(C_bm, J_v).rotation))

    assert rotation(with_base_mass(sms, 2e7)) < 1e-4 * rotation(sms)


@pytest.mark.parametrize("name", ROBOTS)
def test_assistance_is_the_papers_for_the_rates_of_a_fixed_base(name: str, rng: np.random.Generator) -> None:
    sms = ffsms.load(name)
    joints = rng.uniform(-2.0, 2.0, (20, sms.n))
    batch = sms.batch(joints)
    directions = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]])
    on_fixed_base, J_v = batch.J_m[:, :3], batch.J_star[:, :3]
    found = assistance(on_fixed_base.transpose(1, 2, 0), J_v.transpose(1, 2, 0), directions)
    assert found.shape == (2, 20)
    for k, row in enumerate(joints):
        coupling = sms.at(sms.configuration(row)).coupling
        for d, direction in enumerate(directions):
            rates = np.linalg.pinv(on_fixed_base[k], rcond=1e-8) @ direction
            assert found[d, k] == pytest.approx(coupling.assistance(rates, direction), abs=1e-8)


def test_assistance_out_of_the_plane_is_none() -> None:
    batch = ffsms.load("planar_3r").batch([[0.3, 0.4, 0.5]])
    rows = batch.J_m[:, :3].transpose(1, 2, 0), batch.J_star[:, :3].transpose(1, 2, 0)
    assert assistance(*rows, np.array([[0.0, 0.0, 1.0]])).tolist() == [[0.0]]


@pytest.mark.parametrize(("name", "rank"), [("planar_3r", 3), ("satellite_ur5", 6), ("satellite_panda", 6)])
def test_rank_of_most_configurations(name: str, rank: int) -> None:
    assert generic_rank(ffsms.load(name)) == rank
