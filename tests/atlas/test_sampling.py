"""Samples: each row from its number alone, evenly over the joints' ranges."""

from __future__ import annotations

import math

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.atlas.measures import BLOCK, Sampling
from ffsms_pin.errors import InvalidValue

UNIT = Sampling((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 3 * BLOCK)


def test_rows_do_not_depend_on_their_chunk() -> None:
    whole = UNIT.joints(range(BLOCK - 5, BLOCK + 7))
    np.testing.assert_array_equal(whole[:5], UNIT.joints(range(BLOCK - 5, BLOCK)))
    np.testing.assert_array_equal(whole[5:6], UNIT.joints(range(BLOCK, BLOCK + 1)))
    assert UNIT.joints(range(4, 4)).shape == (0, 3)


def test_seed_and_block_both_change_the_points() -> None:
    other = Sampling(UNIT.lower, UNIT.upper, UNIT.rows, seed=1)
    rows = range(100)
    assert not np.array_equal(UNIT.joints(rows), other.joints(rows))
    assert not np.array_equal(UNIT.joints(rows), UNIT.joints(range(BLOCK, BLOCK + 100)))


def test_points_fill_the_ranges_more_evenly_than_random_ones(rng: np.random.Generator) -> None:
    points = UNIT.joints(range(BLOCK))
    # Every one of 16^3 cells holds its share of a Sobol net.
    cells = np.ravel_multi_index(tuple((points * 16).astype(int).T), (16, 16, 16))
    assert set(np.bincount(cells, minlength=4096)) <= set(range(12, 21))
    random = rng.uniform(size=(BLOCK, 3))

    def error(sample: np.ndarray) -> float:
        return abs(float(np.mean(np.prod(sample, axis=1))) - 0.125)

    assert error(points) < 1e-5 < error(random)


def test_ranges_are_the_limits_and_one_turn_where_there_are_none() -> None:
    planar, kinova = ffsms.load("planar_3r"), ffsms.load("satellite_kinova")
    sampling = Sampling.of(planar, 1000)
    joints = sampling.joints(range(1000))
    assert (joints >= planar.limits.lower).all()
    assert (joints <= planar.limits.upper).all()
    assert sampling.upper == tuple(planar.limits.upper)
    free = ~np.isfinite(kinova.limits.upper)
    assert free.any()
    assert all(value == math.pi for value in np.array(Sampling.of(kinova, 10).upper)[free])


def test_a_grid_has_its_corners_and_the_last_joint_fastest() -> None:
    sampling = Sampling.of(ffsms.load("planar_3r"), 30, "grid")
    assert (sampling.rows, sampling.points) == (27, 3)
    joints = sampling.joints(range(27))
    np.testing.assert_allclose(joints[[0, -1]], [sampling.lower, sampling.upper])
    assert (np.diff(joints[:3], axis=0)[:, :2] == 0.0).all()
    np.testing.assert_array_equal(joints[5:9], sampling.joints(range(5, 9)))


def test_what_cannot_be_sampled_is_named() -> None:
    planar = ffsms.load("planar_3r")
    with pytest.raises(InvalidValue, match="at least 8 for a grid of 3"):
        Sampling.of(planar, 7, "grid")
    with pytest.raises(InvalidValue, match="method"):
        Sampling.of(planar, 7, "halton")
    with pytest.raises(InvalidValue, match="samples"):
        Sampling.of(planar, 0)
    with pytest.raises(InvalidValue, match="seed"):
        Sampling.of(planar, 8, seed=-1)
