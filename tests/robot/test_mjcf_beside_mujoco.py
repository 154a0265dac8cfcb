"""Compare robots from random and exported MJCF files with MuJoCo."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from drawn_mjcf import draw
from motions import Array, random_pose

import ffsms_pin as ffsms
import ffsms_pin.export
from ffsms_pin.errors import (
    FfsmsError,
    FfsmsWarning,
    InvalidInertia,
    InvalidUrdf,
    InvalidValue,
    UnsupportedJoint,
)

Refused = Callable[..., FfsmsError]


def compiled_by_mujoco(path: Path) -> mujoco.MjModel:
    """Compile a file by MuJoCo."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # some attributes are deprecated
        return mujoco.MjSpec.from_file(str(path)).compile()


def mujoco_inertia_matrix(compiled: mujoco.MjModel, qpos: Array) -> Array:
    """Return MuJoCo's inertia matrix at a configuration."""
    data = mujoco.MjData(compiled)
    data.qpos[:] = qpos
    mujoco.mj_forward(compiled, data)
    columns = []
    for unit in np.eye(compiled.nv):
        column = np.zeros(compiled.nv)
        mujoco.mj_mulM(compiled, data, column, unit)
        columns.append(column)
    return np.array(columns)


def largest_difference(path: Path, floating: bool) -> float:
    """Return the largest relative difference from MuJoCo's inertia matrix at three configurations.

    The joint block of a mounted arm is compared with the arm on a fixed base in MuJoCo. A whole robot is
    compared with its base; the linear velocity of MuJoCo's base has inertial axes.
    """
    compiled = compiled_by_mujoco(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FfsmsWarning)
        sms = ffsms.load(path) if floating else ffsms.mount(path)
    rng, largest = np.random.default_rng(5), 0.0
    ours = [compiled.joint(name).dofadr[0] for name in sms.joint_names]
    for _ in range(3):
        qpos = rng.uniform(-1.5, 1.5, compiled.nq)
        joints = qpos[[compiled.joint(name).qposadr[0] for name in sms.joint_names]]
        base = random_pose(rng) if floating else None
        if base is not None:
            x, y, z, w = pin.SE3ToXYZQUAT(base)[3:]
            qpos[:7] = [*base.translation, w, x, y, z]
        expected = mujoco_inertia_matrix(compiled, qpos)
        M = pin.crba(sms.model, sms.model.createData(), sms.configuration(joints, base))
        M = np.triu(M) + np.triu(M, 1).T
        if base is None:
            M = M[6:, 6:][np.ix_(np.argsort(ours), np.argsort(ours))]
        else:
            turn = np.eye(compiled.nv)
            turn[:3, :3] = base.rotation.T
            expected = turn @ expected @ turn.T
            order = [*range(6), *(6 + np.argsort(ours))]
            M = M[np.ix_(order, order)]
        largest = max(largest, float(np.abs(M - expected).max() / np.abs(expected).max()))
    return largest


def _check_against_mujoco(seed: int, folder: Path) -> None:
    """Compare a random file with MuJoCo, or check that it is refused if MuJoCo refuses it."""
    floating = seed % 3 == 0
    path = draw(folder, seed, floating)
    try:
        compiled_by_mujoco(path)
    except ValueError:
        with pytest.raises(FfsmsError, match=r"MuJoCo|inertia"):
            ffsms.load(path) if floating else ffsms.mount(path)
        return
    assert largest_difference(path, floating) < 1e-12


@pytest.mark.parametrize("seed", range(60))
def test_a_random_file_has_mujocos_inertia_matrix(seed: int, tmp_path: Path) -> None:
    _check_against_mujoco(seed, tmp_path)


@pytest.mark.slow
def test_more_random_files_have_mujocos_inertia_matrix(tmp_path: Path) -> None:
    for seed in range(60, 200):
        _check_against_mujoco(seed, tmp_path)


BODY = '<joint name="a" axis="0 0 1"/><inertial pos="0.1 0 0.02" mass="2" diaginertia="0.01 0.03 0.03"/>'
LAST = (
    '<body name="l2" pos="0.4 0 0"><joint name="c" axis="0 1 0"/>'
    '<inertial pos="0.2 0 0.1" mass="1.5" diaginertia="0.01 0.03 0.025"/></body>'
)
ARM = f'<body name="l1" pos="0.3 0 0">{BODY}{LAST}</body>'


def written(folder: Path, world: str, rest: str = "", compiler: str = 'angle="radian"') -> Path:
    """Write an MJCF file with bodies in its world and other elements, and return its path."""
    path = folder / "arm.xml"
    path.write_text(
        f'<mujoco model="arm"><compiler {compiler}/><worldbody>{world}</worldbody>{rest}</mujoco>'
    )
    return path


@pytest.mark.parametrize(
    ("world", "rest", "fragment"),
    [
        (ARM.replace('name="a"', 'name="a" stiffness="40"'), "", "springs of the joints ('a')"),
        (ARM, '<equality><joint name="gear" joint1="a" joint2="c"/></equality>', "constraints ('gear')"),
        (
            ARM,
            '<tendon><fixed name="cable"><joint joint="a" coef="1"/></fixed></tendon>',
            "tendons ('cable')",
        ),
        (ARM + '<body name="table"><geom size="1"/></body>', "", "not part of the robot ('table')"),
        (ARM + '<body name="box"><freejoint/><geom size="1"/></body>', "", "not part of the robot ('box')"),
        (ARM + '<geom name="floor" type="plane" size="1 1 1"/>', "", "left out: 'floor'"),
        (ARM.replace(BODY, f"<freejoint/>{BODY}".replace(BODY.split("<inertial")[0], "")), "", "free joint"),
    ],
)
def test_unsupported_elements_are_named_in_a_warning(
    world: str, rest: str, fragment: str, tmp_path: Path
) -> None:
    path = written(tmp_path, world, rest)
    with warnings.catch_warnings(record=True) as recorded:
        warnings.simplefilter("always")
        ffsms.mount(path)
    texts = [str(item.message) for item in recorded]
    assert len(texts) == 1
    assert fragment in texts[0]
    assert recorded[0].filename == __file__


def test_files_that_are_no_robots_are_refused(refused: Refused, tmp_path: Path) -> None:
    ball = ARM.replace('<joint name="a" axis="0 0 1"/>', '<joint name="a" type="ball"/>')
    refused(lambda: ffsms.mount(written(tmp_path, ball)), UnsupportedJoint, "'a' is a ball")
    refused(lambda: ffsms.load(written(tmp_path, ARM)), UnsupportedJoint, "no free joint", "mount")
    base = '<body name="sat{}"><freejoint/><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>{}</body>'
    names = ARM.replace('name="', 'name="second_')
    pair = base.format("1", ARM) + base.format("2", names)
    refused(lambda: ffsms.load(written(tmp_path, pair)), UnsupportedJoint, "'sat1', 'sat2'")
    refused(lambda: ffsms.mount(written(tmp_path, ARM.replace('"0.3 0 0"', '"0.3/2 0 0"'))), InvalidUrdf)
    line = ARM.replace(BODY, f'<joint name="b" axis="0 0 1"/>{BODY}')  # two hinges about the same axis
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FfsmsWarning)
        refused(lambda: ffsms.mount(written(tmp_path, line)), InvalidInertia, "positive definite")
    for option, value in (("package_dirs", ["."]), ("wheels", ["a"]), ("srdf", "a.srdf")):
        path = written(tmp_path, base.format("1", ARM))
        refused(lambda o=option, g=value, p=path: ffsms.load(p, **{o: g}), InvalidValue, option)


def test_inertias_of_mjcf_files_and_models_are_checked(refused: Refused, tmp_path: Path) -> None:
    path = written(tmp_path, ARM.replace('"0.01 0.03 0.03"', '"0.01 0.03 0.09"'))
    refused(lambda: ffsms.mount(path), InvalidInertia, "'l1'", "triangle")
    with pytest.warns(FfsmsWarning, match="'l1' .*kept as published|kept as published.*'l1'"):
        kept = ffsms.mount(path, inertias="keep")
    np.testing.assert_allclose(np.diag(kept.model.inertias[2].inertia), [0.01, 0.03, 0.09], atol=1e-15)
    with pytest.warns(FfsmsWarning, match="'l1' from"):
        repaired = ffsms.mount(path, inertias="repair")
    a, b, c = np.linalg.eigvalsh(repaired.model.inertias[2].inertia)
    assert a + b >= c - 1e-6
    bad = ARM.replace('"0.01 0.03 0.03"', '"0.01 0.03 0.09"')
    path = written(tmp_path, bad, compiler='angle="radian" fusestatic="true" settotalmass="5"')
    for choice in ("keep", "repair"):
        refused(lambda c=choice: ffsms.mount(path, inertias=c), InvalidUrdf, "'l1'", "fusestatic='false'")
    arm = pin.buildSampleModelManipulator()
    second = arm.inertias[2]
    arm.inertias[2] = pin.Inertia(second.mass, second.lever, np.diag([0.01, 0.03, 0.09]))
    refused(lambda: ffsms.mount(arm, end_effector="effector_body"), InvalidInertia, "triangle")
    with pytest.warns(FfsmsWarning, match="kept as published"):
        ffsms.mount(arm, end_effector="effector_body", inertias="keep")


def test_a_missing_mesh_that_has_the_mass_is_refused(refused: Refused, tmp_path: Path) -> None:
    geom = '<geom type="mesh" mesh="m"/>'
    world = ARM.replace(BODY, BODY.split("<inertial")[0] + geom)
    path = written(tmp_path, world, '<asset><mesh name="m" file="gone.stl"/></asset>')
    refused(lambda: ffsms.mount(path), InvalidUrdf, "'l1'", "gone.stl")


def test_torque_limits_come_from_actuators(tmp_path: Path) -> None:
    motors = (
        '<actuator><position joint="a" kp="100" forcerange="-4 4"/>'
        '<motor joint="c" ctrlrange="-5 5" gear="3"/><motor joint="c" ctrlrange="-1 1" gear="-2"/></actuator>'
    )
    assert ffsms.mount(written(tmp_path, ARM, motors)).limits.torque.tolist() == [4.0, 17.0]
    unlimited = motors.replace('ctrlrange="-1 1"', "")
    assert ffsms.mount(written(tmp_path, ARM, unlimited)).limits.torque.tolist() == [4.0, np.inf]


@pytest.mark.parametrize(
    "name",
    [
        "planar_3r",
        "space_arm_7",
        "servicer",
        pytest.param("satellite_panda", marks=[pytest.mark.slow, pytest.mark.long]),
    ],
)
def test_an_exported_mjcf_file_is_the_same_robot(name: str, tmp_path: Path) -> None:
    original = ffsms.load(name)
    model = original.model.copy()
    model.armature[6:] = np.linspace(0.01, 0.2, original.n)
    model.damping[6:], model.upperDryFrictionLimit[6:] = np.linspace(0.1, 2.0, original.n), 0.3
    original = ffsms.load(
        model, original.end_effector, **{kind: original.geometry(kind) for kind in ("visual", "collision")}
    )
    path = tmp_path / "robot.xml"
    path.write_text(ffsms.export.to_mjcf(original))
    assert largest_difference(path, floating=True) < 1e-12
    loaded = ffsms.load(path)
    assert loaded.joint_names == original.joint_names
    for limit in ("lower", "upper", "torque"):
        np.testing.assert_allclose(getattr(loaded.limits, limit), getattr(original.limits, limit), rtol=1e-12)
    joints = np.linspace(-0.3, 0.6, original.n)
    a, b = (sms.at(sms.configuration(joints)) for sms in (loaded, original))
    np.testing.assert_allclose(a.H, b.H, rtol=1e-12, atol=1e-11)
    np.testing.assert_allclose(a.H_q, b.H_q, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(
        a.end_effector_pose.homogeneous, b.end_effector_pose.homogeneous, rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(loaded.model.armature, original.model.armature)
    np.testing.assert_allclose(loaded.joint_damping, original.joint_damping)
    np.testing.assert_allclose(loaded.joint_friction, np.full(original.n, 0.3))
    shapes = {
        sms: [
            (item.parentJoint, *np.round(item.meshColor, 5))
            for item in sms.geometry("visual").geometryObjects
        ]
        for sms in (loaded, original)
    }
    assert sorted(shapes[loaded]) == sorted(shapes[original])
    assert loaded.geometry("collision").ngeoms == original.geometry("collision").ngeoms
