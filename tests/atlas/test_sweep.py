"""Changed designs, and sweeps over them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.atlas import Design, sweep
from ffsms_pin.atlas.designs import (
    stretched,
    with_base_inertia,
    with_base_mass,
    with_link_length,
    with_mount_moved,
)
from ffsms_pin.atlas.measures import wheel_momentum_per_speed
from ffsms_pin.atlas.sweep import pareto
from ffsms_pin.cli import main
from ffsms_pin.errors import InvalidValue
from ffsms_pin.models import SatelliteBase, mount
from ffsms_pin.models.mounting import face_placement


def same(one: ffsms.SpaceManipulator, other: ffsms.SpaceManipulator, joints: np.ndarray) -> bool:
    """Whether two robots have the same coupling and Jacobians."""
    a, b = one.batch(joints), other.batch(joints)
    return bool(np.allclose(a.C_bm, b.C_bm, atol=1e-12) and np.allclose(a.J_star, b.J_star, atol=1e-12))


def test_a_moved_mount_is_a_mount_elsewhere(rng: np.random.Generator) -> None:
    base, shift = SatelliteBase(mass=150.0), np.array([0.05, -0.2, 0.1])
    place = face_placement(base)
    moved = mount("ur5", base, pin.SE3(place.rotation, place.translation + shift))
    found = with_mount_moved(mount("ur5", base, place), shift)
    # The arm's own root link stays with the base; with the mount it moves.
    share = found.model.inertias[1].mass / 150.0 - 1.0
    found = found.with_inertias([moved.model.inertias[1], *list(found.model.inertias)[2:]])
    assert share < 0.05
    assert same(found, moved, rng.uniform(-2.0, 2.0, (10, 6)))


def test_another_base_is_a_mount_on_it(rng: np.random.Generator) -> None:
    planar = ffsms.load("planar_3r")
    base = planar.model.inertias[1]
    heavy = with_base_mass(planar, 3.0 * base.mass)
    assert heavy.model.inertias[1].mass == pytest.approx(3.0 * base.mass)
    np.testing.assert_allclose(heavy.model.inertias[1].inertia, 3.0 * base.inertia)
    stiff = with_base_inertia(planar, 3.0)
    assert stiff.model.inertias[1].mass == pytest.approx(base.mass)
    np.testing.assert_allclose(stiff.model.inertias[1].inertia, 3.0 * base.inertia)
    both = Design(base_mass=2.0, base_inertia=0.5).applied(planar)
    np.testing.assert_allclose(both.model.inertias[1].inertia, base.inertia)
    joints = rng.uniform(-2.0, 2.0, (10, 3))
    assert same(with_base_mass(heavy, base.mass), planar, joints)
    assert not same(heavy, planar, joints)


@pytest.mark.parametrize("joint", ["joint_1", "joint_2", "joint_3"])
def test_a_longer_link_reaches_farther_by_its_length(joint: str) -> None:
    planar, straight = ffsms.load("planar_3r"), np.zeros((1, 3))
    longer = with_link_length(planar, joint, 1.5)
    index = planar.model.getJointId(joint)
    place = (
        planar.model.frames[planar.frame_id].placement
        if joint == "joint_3"
        else planar.model.jointPlacements[index + 1]
    )
    gain = longer.batch(straight).end_effector_position - planar.batch(straight).end_effector_position
    assert gain[0].tolist() == pytest.approx(
        [0.5 * float(np.linalg.norm(place.translation)), 0, 0], abs=1e-12
    )
    assert longer.model.inertias[index].mass == pytest.approx(1.5 * planar.model.inertias[index].mass)
    back = with_link_length(longer, joint, 1.0 / 1.5)
    assert same(back, planar, np.array([[0.3, -0.5, 0.8]]))


def test_a_stretched_rod_is_a_longer_rod() -> None:
    def rod(length: float, radius: float) -> pin.Inertia:
        body = pin.Inertia.FromCylinder(1000.0 * np.pi * radius**2 * length, radius, length)
        return pin.Inertia(body.mass, np.array([0.0, 0.0, 0.5 * length]), body.inertia)

    found = stretched(rod(0.4, 0.05), np.diag([1.0, 1.0, 1.75]), 1.75)
    assert found.isApprox(rod(0.7, 0.05), 1e-12)


def test_what_no_design_can_have_is_named(tmp_path: Path) -> None:
    planar, panda = ffsms.load("planar_3r"), ffsms.load("satellite_panda")
    with pytest.raises(InvalidValue, match="must be one of joint_1"):
        with_link_length(planar, "elbow", 2.0)
    with pytest.raises(InvalidValue, match="a link that has a length"):
        with_link_length(panda, "panda_joint1", 2.0)
    refused: list[dict[str, list[float]]] = [
        {"colour": [1.0]},
        {"base_mass": [0.0]},
        {"base_mass": []},
        {},
        {"link:elbow": [1.0]},
    ]
    for wrong in refused:
        with pytest.raises(InvalidValue):
            sweep(planar, wrong, tmp_path / "never", jobs=1)
    assert not list(tmp_path.iterdir())


def test_a_sweep_measures_every_combination(tmp_path: Path) -> None:
    planar = ffsms.load("planar_3r")
    parameters = {"base_mass": [0.5, 1.0, 4.0], "link:joint_2": [0.8, 1.0, 1.2]}
    found = sweep(planar, parameters, tmp_path / "s", 1024, jobs=1)
    assert found is not None
    assert len(found) == 9
    table = {name: values.reshape(3, 3) for name, values in found.statistics.items()}
    # A heavier base turns less, a longer arm reaches farther.
    assert (np.diff(table["base_rotation"], axis=0) < 0.0).all()
    assert (np.diff(table["base_translation"], axis=0) < 0.0).all()
    assert (np.diff(table["reach"], axis=1) > 0.0).all()
    assert (table["base_rotation_90"] > table["base_rotation"]).all()
    best = found.best()
    assert (found.parameters["base_mass"][best] == 4.0).all()
    with pytest.raises(InvalidValue, match="motion"):
        found.best("beauty")
    again = sweep(planar, parameters, tmp_path / "s", 1024, jobs=1)
    assert again is not None
    assert all((again.statistics[name] == values).all() for name, values in found.statistics.items())


def test_pareto_is_what_nobody_beats(rng: np.random.Generator) -> None:
    large, small = rng.integers(0, 6, (2, 60)).astype(float)
    found = pareto(large, small)
    for i in range(60):
        no_worse = (large >= large[i]) & (small <= small[i])
        better = (large > large[i]) | (small < small[i])
        assert found[i] == (not (no_worse & better).any())


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    arguments = ["sweep", "planar_3r", "--samples", "256", "--jobs", "1", "--out", str(out)]
    assert main([*arguments, "--vary", "base_mass=0.5,2", "--vary", "mount_y=0:0.2:3"]) == 0
    assert "6 designs are not beaten" in capsys.readouterr().out
    content = json.loads((out / "sweep.json").read_text())
    assert content["parameters"]["mount_y"] == pytest.approx([0.0, 0.1, 0.2] * 2)
    assert (out / "pareto.png").stat().st_size > 5_000
    for wrong in ("base_mass", "base_mass=a", "base_mass=1:2:0", "=1"):
        assert main([*arguments, "--vary", wrong]) == 2
        assert "--vary" in capsys.readouterr().err


def with_wheels(sms: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    """Three wheels along the base's axes, and one askew."""
    axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]
    return sms.with_actuators(wheels=ffsms.ReactionWheels(axes, inertia=1e-3))


def test_wheel_momentum_is_pinocchios(rng: np.random.Generator) -> None:
    sms = with_wheels(ffsms.load("satellite_ur5"))
    joints = rng.uniform(-2.0, 2.0, (5, 6))
    shares = np.linalg.pinv(sms.wheels.axes.T)  # type: ignore[union-attr]
    for row, found in zip(joints, wheel_momentum_per_speed(sms, joints), strict=True):
        q = sms.configuration(row)
        data = sms.model.createData()
        pin.ccrba(sms.model, data, q, np.zeros(sms.model.nv))
        A = np.array(data.Ag)
        # The base moves without turning, and the system's linear momentum is zero.
        v = np.vstack([-np.linalg.solve(A[:3, :3], A[:3, 6:]), np.zeros((3, 6)), np.eye(6)])
        pin.computeJointJacobians(sms.model, data, q)
        J = pin.getFrameJacobian(sms.model, data, sms.frame_id, pin.LOCAL_WORLD_ALIGNED)[:3] @ v
        held = shares @ A[3:] @ v @ np.linalg.pinv(J)
        assert found == pytest.approx(np.linalg.norm(held, axis=1).max(), rel=1e-9)


def test_wheels_add_a_column_and_a_panel(tmp_path: Path) -> None:
    sms = with_wheels(ffsms.load("planar_3r"))
    found = sweep(sms, {"base_mass": [1.0, 4.0], "link:joint_2": [1.0, 1.5]}, tmp_path / "s", 256, jobs=1)
    assert found is not None
    filled = found.statistics["wheel_momentum"]
    assert (filled > 0.0).all()
    assert filled[1] != filled[0]  # a longer link
    assert found.best("wheel_momentum").any()
    without = sweep(ffsms.load("planar_3r"), {"base_mass": [1.0]}, tmp_path / "t", 256, jobs=1)
    assert without is not None
    assert "wheel_momentum" not in without.statistics
    with pytest.raises(InvalidValue, match="reaction wheels"):
        wheel_momentum_per_speed(ffsms.load("planar_3r"), np.zeros((1, 3)))
