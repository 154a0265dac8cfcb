"""Test that states are immutable and independent of the order of access and of the base position."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from paper_sums import ARRAYS, assert_near, pinocchio_state, quantities, random_case, random_states

import ffsms_pin as ffsms
from ffsms_pin.system.mechanism import scratch


def test_a_state_stays_valid_when_others_are_computed(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    first, *others = random_states(planar, rng, 6)
    expected = quantities(planar.at(first.q, first.v))
    base, end = planar.at(first.q).base_pose, planar.at(first.q).end_effector_pose
    quantities(others[0])  # the scratch data belongs to another state when `first` is evaluated
    # Half of the quantities are evaluated before other states, half after them. They are compared at the
    # end, because evaluating the same q and v again would hide a changed value.
    quantities(first, ARRAYS[::2])
    for other in others:
        quantities(other)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), expected[name], err_msg=name)
    assert first.base_pose == base
    assert first.end_effector_pose == end


def test_a_state_does_not_change(planar: ffsms.SpaceManipulator) -> None:
    q, v = planar.configuration([0.1, 0.2, 0.3]), np.ones(9)
    state = planar.at(q, v)
    before = quantities(state)
    for name in (*ARRAYS, "q", "v", "coupling", "kinetic_energy"):
        with pytest.raises(AttributeError):
            setattr(state, name, np.zeros(3))
        with pytest.raises(AttributeError):
            delattr(state, name)
    for name in (*ARRAYS, "q", "v"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(state, name)[...] = 0.0
    for name in ("U", "sigma", "V"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(state.coupling, name)[...] = 0.0
    with pytest.raises(AttributeError):
        state.coupling.entropy = 1.0
    # Changes of the arguments and of returned poses do not change the state.
    q[:], v[:] = 0.0, 0.0
    state.base_pose.translation = np.ones(3)
    state.end_effector_pose.translation = np.ones(3)
    again = quantities(planar.at(state.q, state.v))
    for name in ARRAYS:
        np.testing.assert_array_equal(before[name], again[name], err_msg=name)
    np.testing.assert_array_equal(state.base_pose.translation, planar.at(state.q).base_pose.translation)
    np.testing.assert_array_equal(
        state.end_effector_pose.translation, planar.at(state.q).end_effector_pose.translation
    )


def test_a_state_can_be_pickled(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    state = random_states(planar, rng, 1)[0]
    before = quantities(state)
    state.coupling.assistance([1.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    copy = pickle.loads(pickle.dumps(state))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(copy, name), before[name], err_msg=name)
        assert not getattr(copy, name).flags.writeable


def test_states_in_threads(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    states = random_states(planar, rng, 4)
    names = ("com", "J_star", "C_q")

    def work(state: ffsms.State) -> None:
        expected = quantities(state, names)
        for _ in range(400):
            for name, values in quantities(planar.at(state.q, state.v), names).items():
                np.testing.assert_array_equal(values, expected[name], err_msg=name)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads switch within the evaluation of a state
    try:
        with ThreadPoolExecutor(len(states)) as pool:
            for _ in pool.map(work, states):
                pass
            # A race needs a switch at the wrong instant, so also check that scratch data are not shared.
            assert pool.submit(scratch, planar).result() is not scratch(planar)
    finally:
        sys.setswitchinterval(interval)


KINDS = ("revolute", "prismatic", "continuous")


@pytest.mark.parametrize("seed", range(6))
def test_quantities_computed_together_satisfy_their_formulas(
    random_tree: Callable[..., Any], seed: int
) -> None:
    tree = random_tree(seed, seed + 1, KINDS)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(seed))
    s = sms.at(*pinocchio_state(tree, sms, case))
    C_bm = -np.linalg.solve(s.H_b, s.H_bm)
    assert_near("H", s.H, np.block([[s.H_b, s.H_bm], [s.H_bm.T, s.H_m]]))
    assert_near("C_bm", s.C_bm, C_bm)
    assert_near("H_q", s.H_q, s.H_m + s.H_bm.T @ C_bm)
    assert_near("C_q", s.C_q, s.C_m + C_bm.T @ s.C_b)
    assert_near("J*", s.J_star, s.J_b @ C_bm + s.J_m)
    x = np.concatenate([s.base_twist, case.rates])
    assert_near("kinetic energy", s.kinetic_energy, 0.5 * x @ s.H @ x)
    assert_near("end effector twist", s.end_effector_twist, s.J_b @ s.base_twist + s.J_m @ case.rates)


def test_quantities_do_not_depend_on_the_order_of_access(random_tree: Callable[..., Any]) -> None:
    tree = random_tree(2, 4, KINDS)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, v = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(2)))
    other = sms.configuration(np.ones(4))
    names = (*ARRAYS, "kinetic_energy", "end_effector_twist", "C_q_matrix", "base_bias_acceleration")
    expected = quantities(sms.at(q, v), names)
    for name in names:
        assert not np.shape(expected[name]) or not getattr(sms.at(q, v), name).flags.writeable, name
        state = sms.at(q, v)
        quantities(sms.at(other), names)  # Pinocchio's data now belong to another state
        np.testing.assert_array_equal(getattr(state, name), expected[name], err_msg=name)
        quantities(sms.at(other), names)
        for rest, value in quantities(state, names).items():
            np.testing.assert_array_equal(value, expected[rest], err_msg=f"{rest} after {name}")


def test_quantities_far_from_the_origin_have_the_same_bits(random_tree: Callable[..., Any]) -> None:
    tree = random_tree(5, 6)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, v = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(5)))
    away = np.array([2.0**22, -(2.0**20), 2.0**21])  # thousands of kilometres
    far = q.copy()
    far[:3] += away
    near_state, far_state = sms.at(q, v), sms.at(far, v)
    for name in (*ARRAYS, "C_q_matrix", "kinetic_energy", "end_effector_twist"):
        if name != "com":
            np.testing.assert_array_equal(getattr(far_state, name), getattr(near_state, name), err_msg=name)
    for a, b in (
        (far_state.com, near_state.com),
        (far_state.base_pose.translation, near_state.base_pose.translation),
        (far_state.end_effector_pose.translation, near_state.end_effector_pose.translation),
    ):
        np.testing.assert_allclose(a - away, b, rtol=0.0, atol=1e-8)
    momentum = np.arange(1.0, 7.0)
    np.testing.assert_array_equal(sms.velocity(far, v[6:], momentum), sms.velocity(q, v[6:], momentum))


def test_states_without_shared_memory_of_pinocchio(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    state = random_states(planar, rng, 1)[0]
    expected = quantities(state)
    pin.sharedMemory(False)
    try:
        values = quantities(ffsms.load("planar_3r").at(state.q, state.v))
        assert not pin.sharedMemory()
    finally:
        pin.sharedMemory(True)
    for name in ARRAYS:
        np.testing.assert_array_equal(values[name], expected[name], err_msg=name)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", [0, 3, 8])
def test_values_that_are_not_finite_are_refused(
    planar: ffsms.SpaceManipulator, bad: float, where: int
) -> None:
    q, v = planar.configuration([0.1, 0.2, 0.3]), np.zeros(9)
    wrong = q.copy()
    wrong[where] = bad
    with pytest.raises(ffsms.errors.InvalidValue, match="q"):
        planar.at(wrong)
    v[where] = bad
    v[where - 1] = -bad  # the sum of both is NaN
    with pytest.raises(ffsms.errors.InvalidValue, match="v"):
        planar.at(q, v)
    v[:] = 0.0
    v[:2] = 1.5e308  # finite, although their sum overflows
    assert np.isfinite(planar.at(q, v).v).all()


def test_the_quaternion_must_be_of_unit_length_to_a_millionth(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.1, 0.2, 0.3])
    for stretch in (0.9e-6, -0.9e-6, 3e-7):
        scaled = q.copy()
        scaled[3:7] *= 1.0 + stretch
        np.testing.assert_array_equal(planar.at(scaled).q, scaled)
    for stretch in (1.1e-6, -1.1e-6, 1.0):
        scaled = q.copy()
        scaled[3:7] *= 1.0 + stretch
        with pytest.raises(ffsms.errors.InvalidValue, match="must have length 1"):
            planar.at(scaled)
