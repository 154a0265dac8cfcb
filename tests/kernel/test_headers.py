"""The kernel's headers as used by flight software: without Python, exceptions and allocation."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from compiling import compiler

import ffsms_pin as ffsms
from ffsms_pin import kernel
from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.arm import ArmStack

HEADERS = Path(kernel.__file__).parent
BORDER = "arrays.hpp"  # the interface to Python
MAIN = r"""
@INCLUDES@
#include <cstdio>
#include <cstdlib>
#include <new>

void* operator new(std::size_t) { std::abort(); }
void operator delete(void*) noexcept {}
void operator delete(void*, std::size_t) noexcept {}

using namespace ffsms;
static const double joints[] = {@JOINTS@}, bodies[] = {@BODIES@}, tip[] = {@TIP@}, at[] = {@AT@};

int main() {
  static Tree tree = {};
  static Arm<double> arm;
  tree.n = @N@;
  tree.last = @LAST@;
  tree.tip = of_numbers<Placed>(tip);
  tree.moves = tree.turns_freely = true;
  for (int j = 0; j < tree.n; ++j) {
    Joint& joint = tree.joints[j];
    const double* row = joints + 17 * j;
    joint.parent = static_cast<int>(row[0]);
    joint.turns = row[1] != 0.0;
    joint.axis = of_numbers<Vec3<double>>(row + 2);
    joint.place = of_numbers<Placed>(row + 5);
    joint.body = of_numbers<Body>(bodies + 13 * (j + 1));
  }
  complete(tree, of_numbers<Body>(bodies));
  evaluate(tree, at, arm);
  double gradient[6 * kMostJoints];
  for (int i = 0; i < 6 * tree.n; ++i) std::printf("%.17g\n", arm.coupling[i]);
  std::printf("%.17g\n", entropy(6, tree.n, arm.coupling, gradient));
}
"""


def hex_numbers(values: FloatArray) -> str:
    return ", ".join(float(x).hex() for x in np.ravel(values))


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_the_headers_give_the_numbers_of_the_python_module(
    name: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    sms = ffsms.load(name)
    stack, joints = ArmStack(sms), rng.uniform(-1.0, 1.0, sms.n)
    replacements = {
        "INCLUDES": "\n".join(
            f'#include "{header.name}"' for header in sorted(HEADERS.glob("*.hpp")) if header.name != BORDER
        ),
        **dict(zip(("JOINTS", "BODIES", "TIP"), map(hex_numbers, stack.numbers), strict=True)),
        "AT": hex_numbers(joints),
        "N": str(sms.n),
        "LAST": str(stack.last),
    }
    text = MAIN
    for key, value in replacements.items():
        text = text.replace(f"@{key}@", value)
    (tmp_path / "main.cpp").write_text(text)
    strict = ["-std=c++17", "-O2", "-ffp-contract=off", "-fno-exceptions", "-fno-rtti"]
    strict += ["-Wall", "-Wextra", "-Werror"]
    command = [*compiler(), *strict, f"-I{HEADERS}", "main.cpp", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True)
    run = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True)
    printed = [float(line) for line in run.stdout.split()]
    arm = stack.evaluate(joints[:, None])
    np.testing.assert_array_equal(printed[:-1], arm.coupling.ravel())
    assert printed[-1] == kernel.kernel.entropies(arm.coupling)[0, 0]


def test_headers_are_free_of_python_allocation_and_exceptions() -> None:
    headers = [header for header in HEADERS.glob("*.hpp") if header.name != BORDER]
    assert headers
    for header in headers:
        text = header.read_text()
        for token in ("nanobind", "Python.h", "std::vector", "new ", "malloc", "throw "):
            lines = [line for line in text.splitlines() if token in line.partition("//")[0]]
            assert not lines, (header.name, lines)
