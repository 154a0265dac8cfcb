"""Test unused declarations in files: `load` warns once of each kind, `inspect` lists all of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from broken_urdfs import PLANAR, write

import ffsms_pin as ffsms
from ffsms_pin.cli import main
from ffsms_pin.errors import (
    FfsmsError,
    FfsmsWarning,
    InvalidInertia,
    InvalidUrdf,
    InvalidValue,
    UnsupportedJoint,
)
from ffsms_pin.inspection import inspect, repair
from ffsms_pin.robot.mounting import find_arm

Refused = Callable[..., FfsmsError]


def adding(text: str) -> str:
    """Return the planar robot's file with additional elements."""
    return PLANAR.replace("</robot>", text + "</robot>")


XACRO = adding(
    '<xacro:include filename="$(find panels)/panel.xacro"/><xacro:panel mass="61"/><xacro:panel mass="61"/>'
).replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
DEGREES = PLANAR.replace('lower="-2.827433388230814"', 'lower="-162"').replace(
    'upper="2.827433388230814"', 'upper="162"'
)
UNUSED = {
    "xacro": (
        XACRO,
        ["xacro that is not expanded: <xacro:include>, <xacro:panel>, $(find ...)", "xacro FILE"],
    ),
    "argument": (adding('<gazebo><mesh uri="$(arg name)"/></gazebo>'), ["$(arg ...)", "xacro FILE"]),
    "misspelt": (adding("<links/>"), ["<links> in file"]),
    "mass outside": (
        PLANAR.replace('<link name="link_2">', '<link name="link_2"><mass value="9"/>'),
        ["<mass> in link 'link_2'"],
    ),
    "degrees": (DEGREES, ["look like degrees", "joint 'joint_2' (-162 to 162 rad)", "in radians"]),
}


@pytest.mark.parametrize("case", UNUSED)
def test_load_warns_once_of_each_kind(case: str, tmp_path: Path) -> None:
    text, fragments = UNUSED[case]
    with pytest.warns(FfsmsWarning) as recorded:
        ffsms.load(write(tmp_path, text))
    (message,) = [str(warning.message) for warning in recorded]
    assert [warning.filename for warning in recorded] == [__file__]
    for word in fragments:
        assert word in message
    report = inspect(write(tmp_path, text))
    assert report.loads
    assert report.faults
    assert not any(fault.blocks for fault in report.faults)


def test_limits_in_degrees_are_given_in_radians(tmp_path: Path) -> None:
    faults = [fault for fault in inspect(write(tmp_path, DEGREES)).faults if "degrees" in fault.problem]
    assert [fault.where for fault in faults] == ["joint 'joint_2'", "joint 'joint_3'"]
    assert "lower=-2.82743, upper=2.82743" in faults[0].problem


@pytest.mark.parametrize("limit", ["6.283185307179586", "25.0", "1000", "1e10"])
def test_full_turns_and_missing_limits_are_not_taken_for_degrees(limit: str, tmp_path: Path) -> None:
    text = PLANAR.replace('upper="2.827433388230814"', f'upper="{limit}"')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ffsms.load(write(tmp_path, text))


def test_gears_are_listed_by_inspect_alone(tmp_path: Path) -> None:
    """Limits apply to joints, not to motors, so `load` does not warn of gears."""
    gear = (
        "<transmission name='t{}'><actuator name='a'><mechanicalReduction>{}</mechanicalReduction></actuator>"
    )
    path = write(tmp_path, adding("".join(f"{gear.format(i, i)}</transmission>" for i in (1, 2, 50))))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ffsms.load(path)
    (fault,) = inspect(path).faults
    assert "gears are not read (transmission 't2': 2, transmission 't50': 50)" in fault.problem


def test_the_error_for_a_xacro_formula_names_xacro(refused: Refused, tmp_path: Path) -> None:
    path = write(tmp_path, PLANAR.replace('<mass value="0.569"/>', '<mass value="${m}"/>', 1))
    refused(lambda: ffsms.load(path), InvalidUrdf, '"${m}"', "expand the file with xacro")


# -- root links with little mass


def test_a_root_link_with_little_mass_causes_a_warning() -> None:
    path, _ = find_arm("ur5")
    with pytest.warns(FfsmsWarning) as recorded:
        sms = ffsms.load(path)
    (message,) = [str(warning.message) for warning in recorded]
    assert "root link 'world' is read as the satellite and has 19% of the mass (4 of 21 kg)" in message
    assert message.endswith(f"ffsms_pin.mount('{path}')")
    assert sms.model.inertias[1].mass == pytest.approx(4.0)
    assert any("has 19% of the mass" in fault.problem for fault in inspect(path).faults)
    with warnings.catch_warnings():  # no warning if the arm is mounted on a satellite
        warnings.simplefilter("error")
        ffsms.mount(path)


# -- virtual joints of a floating base

_VIRTUAL = (
    '<link name="{0}"/><joint name="to_{1}" type="{2}"><parent link="{0}"/><child link="{1}"/>'
    '<axis xyz="{3}"/><limit lower="-9" upper="9" effort="0" velocity="9"/></joint>'
)
_AXES = ("1 0 0", "0 1 0", "0 0 1")


def virtual(slides: int, turns: int) -> str:
    """Return the planar robot's file with a massless chain from a world link to its base."""
    kinds = ["prismatic"] * slides + ["continuous"] * turns
    axes = [*_AXES[:slides], *reversed(_AXES)]
    names = ["world", *(f"virtual_{i}" for i in range(1, len(kinds))), "base"]
    parts = zip(names, names[1:], kinds, axes, strict=False)
    return adding("".join(_VIRTUAL.format(*part) for part in parts))


@pytest.mark.parametrize(("slides", "turns"), [(2, 1), (3, 3), (3, 1)])
def test_virtual_joints_of_a_base_are_the_free_flyer(
    slides: int, turns: int, refused: Refused, tmp_path: Path
) -> None:
    path = write(tmp_path, virtual(slides, turns))
    refused(lambda: ffsms.load(path), UnsupportedJoint, "'to_virtual_1'", "'to_base'", "inspection.repair(")
    (fault,) = inspect(path).faults
    assert fault.blocks
    assert "let the base float" in fault.problem
    (change,) = repair(path, tmp_path / "repaired.urdf")
    assert "removed" in change.remedy
    again, plain = ffsms.load(tmp_path / "repaired.urdf"), ffsms.load("planar_3r")
    assert again.joint_names == plain.joint_names
    q = plain.configuration([0.1, 0.2, 0.3])
    np.testing.assert_array_equal(again.at(q).H, plain.at(q).H)


def test_a_massless_foot_is_no_virtual_base(refused: Refused, tmp_path: Path) -> None:
    """A single joint from a massless root to a body with mass is the first joint of an arm."""
    path = write(tmp_path, virtual(0, 1))
    refused(lambda: ffsms.load(path, torque=1.0), InvalidInertia, "'world'")


# -- files of clients

CLIENT = (
    '<robot name="client"><link name="b"><inertial><origin xyz="0.1 0 0"/><mass value="10"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="2.5"/></inertial></link></robot>'
)


def test_the_inertia_of_a_client_is_repaired_on_request(refused: Refused, tmp_path: Path) -> None:
    path = write(tmp_path, CLIENT)
    error = refused(lambda: ffsms.Client.from_urdf(path), InvalidInertia, 'inertias="repair"')
    assert "keep" not in str(error)
    with pytest.warns(FfsmsWarning, match=r"'b' from \(1, 1, 2.5\) to \(1.25, 1.25, 2.5\)"):
        client = ffsms.Client.from_urdf(path, inertias="repair")
    np.testing.assert_allclose(client.inertia, np.diag([1.25, 1.25, 2.5]), atol=1e-12)
    keep = "keep"
    refused(lambda: ffsms.Client.from_urdf(path, inertias=keep), InvalidValue, "inertias")  # type: ignore[arg-type]


def test_info_reads_a_file_without_joints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, CLIENT)
    assert main(["info", str(path)]) == 1  # no rigid body has its inertia
    capsys.readouterr()
    assert main(["info", str(path), "--repair", str(tmp_path / "mended.urdf")]) == 0
    output = capsys.readouterr().out
    assert "one rigid body of 10 kg, a client" in output
    assert "Principal inertias 1.25, 1.25, 2.5 kg m²; centre of mass at (0.1, 0, 0) m" in output
    assert ffsms.Client.from_urdf(tmp_path / "mended.urdf").mass == 10.0


def test_info_lists_unused_elements_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["info", str(write(tmp_path, XACRO))]) == 0
    assert capsys.readouterr().out.count("not expanded") == 1


def test_info_lists_damping_and_friction(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = PLANAR.replace("</joint>", '<dynamics damping="4.0" friction="0.25"/></joint>', 1)
    path = write(tmp_path, text)
    assert not inspect(path).faults
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "4 N m s/rad" in shown
    assert "0.25 N m" in shown
    assert main(["info", str(write(tmp_path, PLANAR))]) == 0
    assert "friction" not in capsys.readouterr().out


def test_a_limit_without_a_range_is_refused(refused: Refused, tmp_path: Path) -> None:
    text = PLANAR.replace('lower="-2.827433388230814" upper="2.827433388230814" ', "")
    assert text != PLANAR
    path = write(tmp_path, text)
    refused(lambda: ffsms.load(path), InvalidUrdf, "'joint_2'", "a <limit> without lower and upper")
    assert "limited to" in str(inspect(path).faults[0].remedy)
