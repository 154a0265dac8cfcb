"""Compare `SpaceManipulator.batch` with `SpaceManipulator.at` for all robots."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.robot.loading import satellite_names
from ffsms_pin.system.batch.batch import generic_rank
from ffsms_pin.urdf import model_names

Array = NDArray[np.float64]
ROBOTS = [*model_names(), *satellite_names()]


def load(name: str) -> ffsms.SpaceManipulator:
    """Load a robot; the end effector of `two_arms` is that of the left arm."""
    return ffsms.load(name, end_effector="left_tool" if name == "two_arms" else None)


def close(computed: Array, expected: Array) -> bool:
    """Return whether arrays are equal to 1e-12, relative if the largest entry exceeds one."""
    return bool(np.abs(computed - expected).max() <= 1e-12 * max(1.0, float(np.abs(expected).max())))


def test_h_q_includes_the_inertia_of_rotors() -> None:
    model = load("planar_3r").model.copy()
    model.armature = np.concatenate([np.zeros(6), [0.1, 0.2, 3.0]])
    sms = ffsms.SpaceManipulator(model, "end_effector")
    joints = np.array([[0.3, -0.5, 0.8], [0.0, 1.0, -2.0]])
    for row, H_q in zip(joints, sms.batch(joints).H_q, strict=True):
        assert close(H_q, sms.at(sms.configuration(row)).H_q)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_row_equals_the_state_at_its_joints(name: str, rng: np.random.Generator) -> None:
    sms = load(name)
    joints = rng.uniform(-3.0, 3.0, (25, sms.n))
    batch = sms.batch(joints)
    rank = min(6, sms.n) if name != "planar_3r" else 3
    for i, row in enumerate(joints):
        state = sms.at(sms.configuration(row))
        assert close(batch.C_bm[i], state.C_bm)
        assert close(batch.J_star[i], state.J_star)
        assert close(batch.J_m[i], state.J_m)
        assert close(batch.H_q[i], state.H_q)
        assert close(batch.sigma[i], state.coupling.sigma)
        assert batch.entropy[i] == pytest.approx(state.coupling.entropy, abs=1e-12)
        from_base = state.base_pose.actInv(state.end_effector_pose.translation)
        assert close(batch.end_effector_position[i], from_base)
        volume = float(np.prod(np.linalg.svd(state.J_star, compute_uv=False)[:rank]))
        assert batch.manipulability[i] == pytest.approx(volume, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize(("name", "rank"), [("planar_3r", 3), ("satellite_ur5", 6), ("satellite_panda", 6)])
def test_generic_rank_of_the_generalised_jacobian(name: str, rank: int) -> None:
    assert generic_rank(ffsms.load(name)) == rank


def test_a_heavy_base_hardly_moves(rng: np.random.Generator) -> None:
    sms = ffsms.load("satellite_panda")
    joints = rng.uniform(-2.0, 2.0, (50, 7))
    base, *arm = list(sms.model.inertias)[1:]
    heavy = pin.Inertia(1e5 * base.mass, base.lever, 1e5 * base.inertia)
    moved = np.abs(sms.with_inertias([heavy, *arm]).batch(joints).C_bm).max()
    assert 0.0 < moved < 1e-4 * np.abs(sms.batch(joints).C_bm).max()


def test_manipulability_is_yoshikawas_determinant(rng: np.random.Generator) -> None:
    panda, planar = ffsms.load("satellite_panda"), ffsms.load("planar_3r")
    batch = panda.batch(rng.uniform(-2.0, 2.0, (20, 7)))
    J = batch.J_star
    np.testing.assert_allclose(
        batch.manipulability, np.sqrt(np.linalg.det(J @ J.transpose(0, 2, 1))), rtol=1e-9
    )
    batch = planar.batch(rng.uniform(-2.0, 2.0, (20, 3)))
    in_plane = batch.J_star[:, [0, 1, 5]]
    np.testing.assert_allclose(batch.manipulability, np.abs(np.linalg.det(in_plane)), atol=1e-14)


def test_a_row_does_not_depend_on_the_other_rows(rng: np.random.Generator) -> None:
    """The bits of a row are the same for every length of the stack."""
    sms = ffsms.load("satellite_panda")
    joints = rng.uniform(-2.0, 2.0, (50, 7))
    whole = sms.batch(joints)
    parts = [sms.batch(joints[first : first + 7]) for first in range(0, 50, 7)]
    for name in (
        "C_bm",
        "J_star",
        "J_m",
        "H_q",
        "sigma",
        "entropy",
        "manipulability",
        "end_effector_position",
    ):
        computed = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(computed, getattr(whole, name))


def test_an_empty_batch_and_one_row() -> None:
    sms = ffsms.load("planar_3r")
    none = sms.batch(np.empty((0, 3)))
    assert none.C_bm.shape == (0, 6, 3)
    assert none.sigma.shape == (0, 3)
    assert none.entropy.shape == none.manipulability.shape == (0,)
    assert sms.batch([[0, 1, 2]]).H_q.shape == (1, 3, 3)


def test_a_batch_cannot_be_changed() -> None:
    joints = np.ones((4, 3))
    batch = ffsms.load("planar_3r").batch(joints)
    joints[:] = 0.0
    assert (batch.joints == 1.0).all()
    for name in ("joints", "C_bm", "J_star", "H_q", "sigma", "entropy", "manipulability"):
        assert not getattr(batch, name).flags.writeable, name
    with pytest.raises(AttributeError, match="cannot be changed"):
        batch.joints = joints


@pytest.mark.parametrize(
    "joints",
    [np.ones(3), np.ones((2, 4)), [["a", "b", "c"]], [[0.0, np.nan, 0.0]], [[0, 1e10, 0]], [[1], [2, 3]]],
)
def test_wrong_joints_are_named(joints: object) -> None:
    with pytest.raises(InvalidValue, match="joints"):
        ffsms.load("planar_3r").batch(joints)  # type: ignore[arg-type]
