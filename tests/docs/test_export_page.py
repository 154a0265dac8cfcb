"""Test that the C++ program of docs/export.md compiles without warnings and reads a plan's table."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from compiling import compiler

import ffsms_pin as ffsms
from ffsms_pin import export, opt

PAGE = Path(__file__).parents[2] / "docs" / "export.md"


@pytest.mark.slow
def test_the_program_follows_the_plan(tmp_path: Path) -> None:
    (program,) = re.findall(r"^```cpp\n(.*?)^```$", PAGE.read_text("utf-8"), re.S | re.M)
    (tmp_path / "follow_plan.cpp").write_text(program, "utf-8")
    strict = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror"]
    command = [*compiler(), *strict, "-o", "follow_plan", "follow_plan.cpp"]
    subprocess.run(command, cwd=tmp_path, check=True)
    sms = ffsms.load("planar_3r")
    plan = opt.plan(sms, sms.configuration([0.02, 0.02, 0.02]), [1.0, 0.15, 0.0], duration=6.0)
    export.to_csv(sms, plan, tmp_path / "plan.csv")
    run = subprocess.run(
        [tmp_path / "follow_plan", "plan.csv"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    printed = np.array([line.split() for line in run.stdout.splitlines()], float)
    np.testing.assert_allclose(printed[:, 0], sms.joint_positions(plan.q[-1]), atol=1e-5)
    np.testing.assert_allclose(printed[:, 1], np.abs(plan.tau).max(axis=0), rtol=1e-3)
