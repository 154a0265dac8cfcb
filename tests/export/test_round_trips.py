"""Test that random URDF files keep masses, limits and friction through export and import."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from drawn_urdf import draw
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import export
from ffsms_pin.errors import FfsmsWarning

Array = NDArray[np.float64]


def _reduced(model: pin.Model, joints: dict[str, float]) -> Array:
    """Return the Schur complement of the base block of a model, in the order of `joints`."""
    q = pin.neutral(model)
    for name, value in joints.items():
        joint = model.joints[model.getJointId(name)]
        turn = [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
        q[joint.idx_q : joint.idx_q + joint.nq] = turn
    M = pin.crba(model, model.createData(), q)
    M = np.triu(M) + np.triu(M, 1).T
    order = [model.joints[model.getJointId(name)].idx_v for name in joints]
    H = M[6:, 6:] - M[6:, :6] @ np.linalg.solve(M[:6, :6], M[:6, 6:])
    rows = np.array(order) - 6
    reduced: Array = H[np.ix_(rows, rows)]
    return reduced


def _of(sms: ffsms.SpaceManipulator, joints: dict[str, float]) -> Array:
    """Return H_q with rows and columns in the order of `joints`."""
    rows = [sms.joint_names.index(name) for name in joints]
    H = sms.at(sms.configuration([joints[name] for name in sms.joint_names])).H_q
    return H[np.ix_(rows, rows)]


def _check(sms: ffsms.SpaceManipulator, seed: int, rates: bool = True) -> None:
    """Compare limits and friction with the random numbers."""
    drawn = draw(seed)
    assert sorted(sms.joint_names) == sorted(drawn.limits)
    lower, upper, velocity, effort = np.array([drawn.limits[name] for name in sms.joint_names]).T
    damping, friction = np.array([drawn.dynamics[name] for name in sms.joint_names]).T
    limits = sms.limits
    pairs = [(limits.lower, lower), (limits.upper, upper), (limits.torque, effort)]
    pairs += [(sms.joint_damping, damping), (sms.joint_friction, friction)]
    for values, drawn_values in [*pairs, (limits.velocity, velocity)] if rates else pairs:
        np.testing.assert_allclose(values, drawn_values, rtol=1e-12, atol=1e-12)


def _there_and_back(seed: int, folder: Path) -> None:
    drawn = draw(seed)
    path = folder / "drawn.urdf"
    path.write_text(drawn.text)
    sms = ffsms.load(path, end_effector=drawn.tip)
    own = pin.buildModelFromXML(drawn.text, pin.JointModelFreeFlyer())
    rng = np.random.default_rng(seed)
    joints = {name: float(rng.uniform(-3.0, 3.0)) for name in drawn.limits}
    expected = _reduced(own, joints)
    written = folder / "written.urdf"
    export.to_urdf(sms, written)
    compiled = folder / "written.xml"
    compiled.write_text(export.to_mjcf(sms))
    robots = [
        sms,
        ffsms.load(written, end_effector=drawn.tip),
        ffsms.load(compiled, end_effector="end_effector"),
    ]
    tip = sms.at(sms.configuration([joints[name] for name in sms.joint_names])).end_effector_pose
    for robot, rates in zip(robots, (True, True, False), strict=True):  # MJCF has no rate limits
        np.testing.assert_allclose(
            _of(robot, joints), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max()
        )
        _check(robot, seed, rates)
        pose = robot.at(robot.configuration([joints[name] for name in robot.joint_names])).end_effector_pose
        np.testing.assert_allclose(pose.homogeneous, tip.homogeneous, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seeds", [range(10), range(10, 20), range(20, 30)], ids=str)
def test_random_files_are_unchanged_by_export_and_import(seeds: range, tmp_path: Path) -> None:
    for seed in seeds:
        _there_and_back(seed, tmp_path)


@pytest.mark.slow
@pytest.mark.long
def test_more_random_files_are_unchanged_by_export_and_import(tmp_path: Path) -> None:
    for seed in range(30, 200):
        _there_and_back(seed, tmp_path)


def test_armature_is_read_back_from_mjcf(tmp_path: Path) -> None:
    """A URDF has no armature, so its export warns."""
    for seed in range(5):
        drawn = draw(seed)
        model = pin.buildModelFromXML(drawn.text, pin.JointModelFreeFlyer())
        model.armature[6:] = np.linspace(0.1, 0.4, model.nv - 6)
        sms = ffsms.load(model, end_effector=drawn.tip)
        path = tmp_path / "written.xml"
        path.write_text(export.to_mjcf(sms))
        again = ffsms.load(path, end_effector="end_effector")
        by_name = dict(zip(sms.joint_names, sms.model.armature[6:], strict=True))
        np.testing.assert_allclose(again.model.armature[6:], [by_name[name] for name in again.joint_names])
        joints = dict.fromkeys(sms.joint_names, 0.4)
        np.testing.assert_allclose(_of(again, joints), _of(sms, joints), rtol=1e-12, atol=1e-12)
        with pytest.warns(FfsmsWarning, match="armature"):
            export.to_urdf(sms, tmp_path / "written.urdf")
