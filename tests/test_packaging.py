"""Test the built distribution outside the checkout, and the symbolic links `opt` and `urdf`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from email import message_from_string
from pathlib import Path

import pytest

import ffsms_pin
import ffsms_pin.opt
import ffsms_pin.urdf

CHECKOUT = Path(__file__).resolve().parents[1]

USE = """
import pathlib, sys
import ffsms_pin, ffsms_pin.opt, ffsms_pin.urdf
for module in (ffsms_pin, ffsms_pin.opt, ffsms_pin.urdf):
    assert pathlib.Path(module.__file__).is_relative_to(sys.argv[1]), module.__file__
sms = ffsms_pin.load("planar_3r")
trajectory = ffsms_pin.opt.plan(sms, sms.configuration([0.4, 0.7, -0.5]), [0.7, 0.5, 0.0], 4.0, 0.02)
print("reached" if trajectory.reached else "missed")
"""


def run(*command: str, cwd: Path, **environment: str) -> str:
    result = subprocess.run(
        command, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the installed wheel, built from the sdist, without dependencies."""
    built = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(built), str(CHECKOUT)]
    # Without optimisation and the second build for AVX2, compiling takes a third of the time.
    run(*command, cwd=built, SKBUILD_CMAKE_BUILD_TYPE="Debug", SKBUILD_CMAKE_DEFINE="HAS_AVX2=OFF")
    (wheel,) = built.glob("*.whl")
    assert list(built.glob("*.tar.gz"))
    target = tmp_path_factory.mktemp("site")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    run(*pip, "--target", str(target), str(wheel), cwd=built)
    return target


@pytest.mark.slow
def test_the_wheel_plans_from_any_folder(installed: Path, tmp_path: Path) -> None:
    output = run(sys.executable, "-c", USE, str(installed), cwd=tmp_path, PYTHONPATH=str(installed))
    assert output.strip() == "reached"


@pytest.mark.slow
def test_the_wheel_contains_its_data_files(installed: Path) -> None:
    package = installed / "ffsms_pin"
    files = ("urdf/planar_3r.urdf", "opt/problem.py", "scenarios/case-2.toml")
    for name in ("py.typed", *files):
        assert (package / name).is_file(), name
    assert sorted(path.name for path in installed.iterdir() if not path.name.endswith(".dist-info")) in (
        ["bin", "ffsms_pin"],
        ["Scripts", "ffsms_pin"],
    )


@pytest.mark.slow
def test_links_of_the_package_description_are_absolute(installed: Path) -> None:
    (info,) = installed.glob("ffsms_pin-*.dist-info")
    metadata = message_from_string((info / "METADATA").read_text(encoding="utf-8"))
    assert metadata["Version"] == ffsms_pin.__version__
    assert metadata["Description-Content-Type"] == "text/markdown"
    text = metadata.get_payload()
    assert isinstance(text, str)
    readme = (CHECKOUT / "README.md").read_text(encoding="utf-8")
    assert len(text) > 0.8 * len(readme)
    links = re.findall(r"\]\(([^)]*)\)", text)
    assert links
    assert all(link.startswith("https://") for link in links)


def test_the_citation_has_the_same_version() -> None:
    text = (CHECKOUT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", text, re.M)[1] == ffsms_pin.__version__  # type: ignore[index]


@pytest.mark.slow
def test_the_wheel_has_the_command(installed: Path, tmp_path: Path) -> None:
    output = run(sys.executable, "-m", "ffsms_pin", "--help", cwd=tmp_path, PYTHONPATH=str(installed))
    assert "run" in output


def test_opt_and_urdf_are_relative_links_to_the_top_level() -> None:
    for name in ("opt", "urdf"):
        link = CHECKOUT / "ffsms_pin" / name
        assert link.is_symlink()
        assert os.readlink(link) == f"../{name}"


def test_no_class_exists_twice() -> None:
    """Test that `opt` and `urdf` are imported through the package only."""
    assert ffsms_pin.opt.StepPlanner.__module__ == "ffsms_pin.opt.replan.step_planner"
    assert "opt" not in sys.modules
    assert "urdf" not in sys.modules
