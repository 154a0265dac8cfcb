"""Coupling metrics in other units, for other points of the base, and for selected rows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scripts import load_script

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidValue

Array = NDArray[np.float64]
Builder = Callable[..., Any]
ROOT = Path(__file__).parents[2]


def random_state(random_tree: Builder, seed: int, n: int) -> tuple[ffsms.SpaceManipulator, ffsms.State]:
    sms = ffsms.SpaceManipulator(random_tree(seed, n, ("revolute",)).model(), "tip")
    rng = np.random.default_rng(seed)
    base = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-1, 1, size=3)), rng.uniform(-1, 1, size=3))
    return sms, sms.at(sms.configuration(rng.uniform(-2.0, 2.0, size=n), base))


def scaled_robot(sms: ffsms.SpaceManipulator, factor: float) -> ffsms.SpaceManipulator:
    """Return the same robot in a unit of length of 1 / factor metres."""
    model = sms.model.copy()
    for j in range(1, model.njoints):
        place, body = model.jointPlacements[j], model.inertias[j]
        model.jointPlacements[j] = pin.SE3(place.rotation, place.translation * factor)
        model.inertias[j] = pin.Inertia(body.mass, body.lever * factor, body.inertia * factor**2)
    return ffsms.SpaceManipulator(model, sms.end_effector)


def matrix_of(coupling: Any) -> Array:
    S = np.zeros((len(coupling.U), len(coupling.V)))
    np.fill_diagonal(S, coupling.sigma)
    return np.asarray(coupling.U @ S @ coupling.V.T)


def test_defaults_are_those_of_the_paper(random_tree: Builder) -> None:
    sms, state = random_state(random_tree, 1, 5)
    for other in (state.coupling_at(), state.coupling_at(1.0, sms.base_com, "all")):
        np.testing.assert_array_equal(other.sigma, state.coupling.sigma)
        assert other.entropy == state.coupling.entropy


@pytest.mark.parametrize("n", [3, 7])
def test_a_characteristic_length_is_a_change_of_unit(random_tree: Builder, n: int) -> None:
    sms, state = random_state(random_tree, 2, n)
    for length in (10.0, 0.1, 0.001):
        q = np.array(state.q)
        q[:3] /= length
        expected = scaled_robot(sms, 1.0 / length).at(q).coupling
        scaled = state.coupling_at(characteristic_length=length)
        np.testing.assert_allclose(scaled.sigma, expected.sigma, rtol=1e-11, atol=1e-13 * expected.sigma[0])
        assert scaled.entropy == pytest.approx(expected.entropy, abs=1e-12)
        assert abs(scaled.entropy - state.coupling.entropy) > 1e-3


def test_the_coupling_at_a_point_is_the_twist_of_that_point(random_tree: Builder) -> None:
    sms, state = random_state(random_tree, 3, 6)
    point = np.array([0.4, -0.3, 0.7])
    model = sms.model.copy()
    frame = model.addFrame(pin.Frame("point", 1, 0, pin.SE3(np.eye(3), point), pin.FrameType.OP_FRAME))
    data, columns = model.createData(), []
    for rates in np.eye(6):
        pin.forwardKinematics(model, data, state.q, sms.velocity(state.q, rates))
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        columns.append(pin.getFrameVelocity(model, data, frame, axes).vector)
    expected = np.array(columns).T
    np.testing.assert_allclose(matrix_of(state.coupling_at(reference=point)), expected, rtol=0.0, atol=1e-13)
    assert np.abs(state.coupling_at(reference=point).sigma - state.coupling.sigma).max() > 1e-3
    # The point is changed before the unit.
    expected[:3] /= 0.25
    np.testing.assert_allclose(matrix_of(state.coupling_at(0.25, point)), expected, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_metrics_of_translation_or_rotation_alone(random_tree: Builder, n: int) -> None:
    _, state = random_state(random_tree, 4, n)
    for rows, block in (("translation", slice(0, 3)), ("rotation", slice(3, 6))):
        scaled = state.coupling_at(rows=rows)  # type: ignore[arg-type]
        assert scaled.U.shape == (3, 3)
        assert scaled.V.shape == (n, n)
        assert scaled.sigma.shape == (min(3, n),)
        np.testing.assert_allclose(matrix_of(scaled), state.C_bm[block], rtol=0.0, atol=1e-14)
        share = scaled.sigma / scaled.sigma.sum()
        entropy = -sum(x * np.log(x) for x in share if x > 0.0) / np.log(n) if n > 1 else 0.0
        assert scaled.entropy == pytest.approx(entropy, abs=1e-13)
    translation, rotation = state.coupling_at(rows="translation"), state.coupling_at(rows="rotation")
    # The unit cancels if all rows have it, and the rotation is the same for every point.
    assert state.coupling_at(0.01, rows="translation").entropy == pytest.approx(
        translation.entropy, abs=1e-12
    )
    other_point = state.coupling_at(0.01, [1.0, 2.0, 3.0], "rotation")
    np.testing.assert_array_equal(other_point.sigma, rotation.sigma)
    # Small lengths leave translation alone, large lengths rotation alone.
    assert state.coupling_at(1e-9).entropy == pytest.approx(translation.entropy, abs=1e-6)
    assert state.coupling_at(1e9).entropy == pytest.approx(rotation.entropy, abs=1e-6)


def test_assistance_depends_on_no_scaling(random_tree: Builder) -> None:
    _, state = random_state(random_tree, 5, 4)
    rates, direction = np.array([0.1, -0.2, 0.3, 0.2]), np.array([1.0, 2.0, -1.0])
    expected = state.coupling.assistance(rates, direction)
    for other in (state.coupling_at(0.1), state.coupling_at(2.0, [1.0, 0.0, 0.0], "translation")):
        assert other.assistance(rates, direction) == expected


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"characteristic_length": 0.0}, "characteristic_length"),
        ({"characteristic_length": -1.0}, "characteristic_length"),
        ({"reference": [0.0, 1.0]}, "reference"),
        ({"rows": "linear"}, "rows"),
    ],
)
def test_wrong_scalings_are_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError], arguments: Any, name: str
) -> None:
    state = planar.at(planar.configuration([0.1, 0.2, 0.3]))
    refused(lambda: state.coupling_at(**arguments), InvalidValue, f"{name} must")


def test_the_tables_in_the_docs_agree_with_the_code() -> None:
    script = load_script("benchmarks/metrics.py")
    recorded = (ROOT / "docs" / "records" / "metrics.md").read_text(encoding="utf-8")
    assert recorded.partition("\n\n")[2] == f"{script.tables()}\n"
    assert script.tables().count("\n|") == 12
