"""Limit the number of files that one call enters, and the number of imports inside functions."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.scenarios.definition import packaged_path

ROOT = Path(ffsms.__file__).parent.resolve()
FOLDERS = (ROOT, Path(opt.__file__).parent.resolve())


def files_entered(call: Callable[[], Any]) -> set[str]:
    """Return the files of the package whose functions a call enters."""
    names = set[str]()

    def trace(frame: Any, event: str, argument: Any) -> None:
        if frame.f_code.co_flags & inspect.CO_OPTIMIZED:  # leave out the bodies of modules
            names.add(frame.f_code.co_filename)

    sys.settrace(trace)  # faster than `sys.setprofile`, which also reports calls of C functions
    try:
        call()
    finally:
        sys.settrace(None)
    resolved = {Path(name).resolve() for name in names if not name.startswith("<")}
    resolved.discard(ROOT / "__init__.py")  # it imports names once in a process, perhaps in an earlier test
    return {path.as_posix() for path in resolved if any(path.is_relative_to(folder) for folder in FOLDERS)}


def late_imports() -> Iterator[tuple[str, str]]:
    """Yield files, and the modules of other subpackages that they import inside functions."""
    for folder in FOLDERS:
        for path in sorted(folder.rglob("*.py")):
            relative = path.relative_to(folder)
            own = "opt" if folder != ROOT else relative.parts[0].removesuffix(".py")
            for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)):
                    continue
                for node in ast.walk(function):
                    module = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
                    if module.startswith("ffsms_pin.") and module.split(".")[1] != own:
                        yield relative.as_posix(), module


def test_a_plan_enters_at_most_forty_files() -> None:
    sms = ffsms.load("planar_3r")
    q0 = sms.home()
    files = files_entered(lambda: opt.plan(sms, q0, [1.9, 0.3, 0.0], duration=12.0))
    assert any(name.endswith("/opt/plans.py") for name in files)
    assert len(files) <= 40, sorted(files)


def test_a_run_of_a_packaged_scenario_enters_at_most_sixty_five_files(tmp_path: Path) -> None:
    file = tmp_path / "case-2.toml"
    text = packaged_path("case-2").read_text(encoding="utf-8")
    coarse = text.replace("\ndt = 0.001 ", "\ndt = 0.01 ").replace("\ndt = 0.01 ", "\ndt = 0.1 ", 1)
    assert coarse.count("\ndt = 0.01 ") == coarse.count("\ndt = 0.1 ") == 1
    file.write_text(coarse, encoding="utf-8")  # tracing is slow, so the steps are ten times as long
    files = files_entered(lambda: main(["run", str(file), "--out", str(tmp_path / "out")]))
    assert (tmp_path / "out" / "summary.json").is_file()
    assert any(name.endswith("/cli/run.py") for name in files)
    assert len(files) <= 65, sorted(files)


def test_few_imports_of_other_packages_are_inside_functions() -> None:
    late = list(late_imports())
    assert len(late) < 40, late


def test_no_method_is_looked_up_by_its_name() -> None:
    """Optional methods belong to a Protocol or a base class, so that a type checker finds errors."""
    packages = [ROOT / name for name in ("actuation", "capture", "client", "control", "robot", "simulation")]
    calls = []
    for folder in (*packages, FOLDERS[1]):
        for path in sorted(folder.rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    optional = node.func.id == "getattr" and len(node.args) == 3
                    if optional or node.func.id == "hasattr":
                        calls.append(f"{path.name}: {ast.unparse(node)}")
    # A counter of each thread, and scalars without `ndim`.
    assert set(calls) <= {
        "derivatives.py: getattr(_lost, 'count', 0)",
        "derivatives.py: getattr(values, 'ndim', 0)",
    }
