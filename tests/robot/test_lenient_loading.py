"""Load files with missing limits, mimicking joints and inertias that no rigid body has."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from paper_sums import assert_near

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsWarning, InvalidInertia, InvalidUrdf

# A bus with an arm in the style of the files of SPART, whose joints have no <limit>.
LINK = """<link name="{name}"><inertial><origin xyz="0 0 {z}" rpy="0 0 0"/><mass value="{mass}"/>
<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 {z}" rpy="0 0 0"/><axis xyz="{axis}"/>{more}</joint>"""
BUS = LINK.format(name="bus", z=0.0, mass=60.0, ixx=4.0, iyy=4.0, izz=4.0)
AXES = ("0 0 1", "0 1 0", "0 1 0")


def satellite(more: tuple[str, str, str] = ("", "", ""), ixx: float = 0.04, kind: str = "revolute") -> str:
    """Return a bus with three links; `more` are further elements of the joints, `ixx` is of link 2."""
    text = BUS
    for i in range(1, 4):
        parent, z = ("bus", 0.5) if i == 1 else (f"link{i - 1}", 0.4)
        inertia = ixx if i == 2 else 0.04
        text += LINK.format(name=f"link{i}", z=0.2, mass=2.0, ixx=inertia, iyy=0.03, izz=0.02)
        text += JOINT.format(
            name=f"joint{i}",
            kind=kind,
            parent=parent,
            child=f"link{i}",
            z=z,
            axis=AXES[i - 1],
            more=more[i - 1],
        )
    return f'<robot name="published">{text}</robot>'


def write(folder: Path, text: str) -> Path:
    path = folder / "published.urdf"
    path.write_text(text)
    return path


def limit(velocity: float = 0.3, effort: float = 9.0) -> str:
    return f'<limit lower="-2" upper="2" velocity="{velocity}" effort="{effort}"/>'


LIMITED = (limit(), limit(), limit())


def load_without_warning(path: Path, **options: Any) -> ffsms.SpaceManipulator:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return ffsms.load(path, **options)


def test_joints_without_limits(tmp_path: Path) -> None:
    path = write(tmp_path, satellite(("", limit(), "")))
    with pytest.warns(
        FfsmsWarning, match=r"-pi to pi rad, velocity 0.5 rad/s.*'joint1', 'joint3'"
    ) as recorded:
        sms = ffsms.load(path)
    assert len(recorded) == 1
    assert recorded[0].filename == __file__
    np.testing.assert_array_equal(sms.limits.upper, [np.pi, 2.0, np.pi])
    np.testing.assert_array_equal(sms.limits.lower, [-np.pi, -2.0, -np.pi])
    np.testing.assert_array_equal(sms.limits.velocity, [0.5, 0.3, 0.5])
    np.testing.assert_array_equal(sms.limits.torque, [100.0, 9.0, 100.0])
    with pytest.warns(FfsmsWarning, match="rad, effort 100 N m: 'joint1'"):
        sms = ffsms.load(path, velocity=[0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sms.limits.velocity, [0.1, 0.2, 0.3])
    with pytest.warns(FfsmsWarning, match="joint1"):
        mounted = ffsms.mount(path, torque=7.0)
    np.testing.assert_array_equal(mounted.limits.torque, [7.0, 7.0, 7.0])


def test_missing_limits_equal_the_default_limits(tmp_path: Path) -> None:
    full = '<limit lower="-3.141592653589793" upper="3.141592653589793" velocity="0.5" effort="100"/>'
    expected = load_without_warning(write(tmp_path, satellite((full, full, full))))
    with pytest.warns(FfsmsWarning, match="without <limit>"):
        loaded = ffsms.load(write(tmp_path, satellite()))
    assert loaded.model == expected.model


@pytest.mark.parametrize(("key", "argument"), [("velocity", "velocity"), ("effort", "torque")])
def test_arguments_replace_zero_limits(key: str, argument: str, tmp_path: Path) -> None:
    path = write(tmp_path, satellite((limit(**{key: 0.0}), limit(), limit())))
    with pytest.raises(InvalidUrdf, match=rf"joint1.*{argument}="):
        ffsms.load(path)
    sms = load_without_warning(path, **{argument: 0.25})
    np.testing.assert_array_equal(getattr(sms.limits, argument), 0.25)
    other = sms.limits.torque if key == "velocity" else sms.limits.velocity
    np.testing.assert_array_equal(other, 9.0 if key == "velocity" else 0.3)


def test_a_tilde_in_a_path_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path, satellite(LIMITED))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert load_without_warning(Path("~/published.urdf")).n == 3
    assert ffsms.mount("~/published.urdf").n == 3


def test_a_locked_joint_is_fixed_at_its_position(tmp_path: Path) -> None:
    path = write(tmp_path, satellite(LIMITED))
    free, held = load_without_warning(path), load_without_warning(path, locked={"joint2": 0.7})
    assert held.joint_names == ["joint1", "joint3"]
    a = free.at(free.configuration([0.2, 0.7, -0.4], pin.SE3.Identity()))
    b = held.at(held.configuration([0.2, -0.4], pin.SE3.Identity()))
    assert_near("H_m", b.H_m, a.H_m[np.ix_([0, 2], [0, 2])])
    assert_near("H_b", b.H_b, a.H_b)
    assert_near("pose", b.end_effector_pose.homogeneous, a.end_effector_pose.homogeneous)
    arm = ffsms.load("satellite_xarm7", locked={"joint3": 0.4}, velocity=0.3)
    assert arm.n == 6
    np.testing.assert_array_equal(arm.limits.velocity, 0.3)


MIMIC = '<mimic joint="{}" multiplier="{}" offset="{}"/>'


@pytest.mark.parametrize(
    ("locked", "mimics", "as_locked", "pattern"),
    [
        # The mimicked joint is locked, so the joint is locked at its mimicking position.
        ({"joint1": 0.3}, {3: ("joint1", -2.0, 0.1)}, {"joint1": 0.3, "joint3": -0.5}, None),
        # The mimicked joint moves, so the joint is locked at its offset.
        ({}, {3: ("joint1", -2.0, 0.1)}, {"joint3": 0.1}, "'joint3' at 0.1 .it mimics 'joint1'"),
        # A joint mimics a joint that mimics another joint.
        (
            {"joint1": 0.3},
            {2: ("joint1", 2.0, 0.1), 3: ("joint2", -1.0, 0.2)},
            {"joint1": 0.3, "joint2": 0.7, "joint3": -0.5},
            None,
        ),
        # The argument has priority over <mimic>.
        ({"joint3": 0.9}, {3: ("joint1", -2.0, 0.1)}, {"joint3": 0.9}, None),
    ],
)
def test_joints_that_mimic(
    locked: dict[str, float],
    mimics: dict[int, tuple[str, float, float]],
    as_locked: dict[str, float],
    pattern: str | None,
    tmp_path: Path,
) -> None:
    parts = [MIMIC.format(*mimics[i]) if i in mimics else "" for i in (1, 2, 3)]
    # Compare a file with <mimic> with a file without <mimic> whose joints are locked by the argument.
    locked_all = len(as_locked) == 3
    fourth = LINK.format(name="hand", z=0.1, mass=1.0, ixx=0.01, iyy=0.01, izz=0.01) + JOINT.format(
        name="joint4", kind="revolute", parent="link3", child="hand", z=0.4, axis="1 0 0", more=limit()
    )
    plain = satellite(LIMITED).replace("</robot>", fourth + "</robot>")
    text = satellite((limit() + parts[0], limit() + parts[1], limit() + parts[2]))
    text = text.replace("</robot>", fourth + "</robot>")
    expected = load_without_warning(write(tmp_path, plain), locked=as_locked)
    path = write(tmp_path, text)
    if pattern is None:
        loaded = load_without_warning(path, locked=locked)
    else:
        with pytest.warns(FfsmsWarning, match=pattern):
            loaded = ffsms.load(path, locked=locked)
    assert loaded.joint_names == expected.joint_names
    assert (loaded.joint_names == ["joint4"]) is locked_all
    joints = np.linspace(0.2, 0.6, loaded.n)
    state, same = (sms.at(sms.configuration(joints)) for sms in (loaded, expected))
    assert_near("H", state.H, same.H)
    assert_near("pose", state.end_effector_pose.homogeneous, same.end_effector_pose.homogeneous)


def test_a_mimic_of_a_fixed_joint_is_fixed_at_its_offset(tmp_path: Path) -> None:
    mimic = MIMIC.format("joint1", 3.0, 0.2)
    text = satellite((limit(), limit(), limit() + mimic))
    text = text.replace('"joint1" type="revolute"', '"joint1" type="fixed"')
    assert load_without_warning(write(tmp_path, text)).joint_names == ["joint2"]


def test_published_inertias(tmp_path: Path) -> None:
    path = write(tmp_path, satellite(LIMITED, ixx=0.08))  # 0.02 + 0.03 < 0.08
    with pytest.raises(InvalidInertia, match=r'link2.*triangle.*inertias="keep"'):
        ffsms.load(path)
    with pytest.warns(FfsmsWarning, match=r"kept as published.*'link2' \(0.02, 0.03, 0.08\)"):
        kept = ffsms.load(path, inertias="keep")
    body = kept.model.inertias[kept.model.getJointId("joint2")]
    np.testing.assert_array_equal(body.inertia, np.diag([0.08, 0.03, 0.02]))
    assert np.linalg.eigvalsh(kept.at(kept.configuration([0.1, 0.2, 0.3])).H)[0] > 0.0
    with pytest.warns(FfsmsWarning, match=r"'link2' from \(0.02, 0.03, 0.08\) to \(0.035, 0.045, 0.08\)"):
        mended = ffsms.load(path, inertias="repair")
    # The second moments are (-0.015, 0.035, 0.045); repair sets the negative value to zero.
    body = mended.model.inertias[mended.model.getJointId("joint2")]
    np.testing.assert_allclose(body.inertia, np.diag([0.08, 0.045, 0.035]), atol=1e-15)
    with pytest.warns(FfsmsWarning, match="link2"):
        assert ffsms.mount(path, inertias="keep").n == 3


def test_inertias_that_are_not_positive_definite_are_not_kept(tmp_path: Path) -> None:
    path = write(tmp_path, satellite(LIMITED, ixx=-0.01))
    with pytest.raises(InvalidInertia, match=r"link2.*negative"):
        ffsms.load(path, inertias="keep")
    with pytest.warns(FfsmsWarning, match="link2"):
        sms = ffsms.load(path, inertias="repair")
    body = sms.model.inertias[sms.model.getJointId("joint2")]
    a, b, c = np.linalg.eigvalsh(body.inertia)
    assert a > 0.0
    assert a + b >= c * (1.0 - 1e-12)


def test_a_planar_tensor_can_only_be_repaired(tmp_path: Path) -> None:
    """Test an inertia about one axis only, as in published files of planar robots."""
    text = satellite(LIMITED, ixx=0.08).replace('iyy="0.03"', 'iyy="0"').replace('izz="0.02"', 'izz="0"')
    path = write(tmp_path, text)
    with pytest.raises(InvalidInertia, match=r'0 \+ 0 < 0.04 kg m\^2; load it with inertias="repair"$'):
        ffsms.load(path)
    with pytest.warns(FfsmsWarning):
        assert ffsms.load(path, inertias="repair").n == 3


def test_valid_inertias_stay_as_they_are(tmp_path: Path) -> None:
    path = write(tmp_path, satellite(LIMITED))
    assert (
        load_without_warning(path).model
        == load_without_warning(path, inertias="keep").model
        == load_without_warning(path, inertias="repair").model
    )
