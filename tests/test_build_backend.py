"""Test the choice of the compiler in the build backend."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from scripts import load_script

TOOLS = Path(__file__).resolve().parents[1] / "tools"


@pytest.fixture(scope="module")
def backend() -> ModuleType:
    return load_script("tools/backend.py")


@pytest.mark.skipif(os.name == "nt", reason="CMake looks for Microsoft's compiler itself")
class TestChoice:
    def test_without_a_compiler_the_build_requires_ziglang(
        self, backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.delenv("CXX", raising=False)
        monkeypatch.setenv("PATH", str(tmp_path))
        for requires in (backend.get_requires_for_build_wheel, backend.get_requires_for_build_editable):
            assert [name for name in requires() if name.startswith("ziglang")]

    def test_an_installed_or_named_compiler_is_used(
        self, backend: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setenv("PATH", str(tmp_path))
        monkeypatch.setenv("CXX", "/somewhere/c++")
        assert not backend.needs_zig()
        monkeypatch.delenv("CXX")
        for name in ("c++", "g++", "clang++"):
            compiler = tmp_path / name
            compiler.write_text("#!/bin/sh\n")
            compiler.chmod(0o755)
            assert not backend.needs_zig()
            compiler.unlink()
        assert backend.needs_zig()

    def test_the_compiler_commands_pass_all_arguments(self, backend: ModuleType, tmp_path: Path) -> None:
        """If zig is not installed, Python's error shows that the arguments were passed on."""
        folder = backend.zig_tools(tmp_path / "with space")
        assert {path.name for path in folder.iterdir()} == {"c++", "ar", "ranlib"}
        completed = subprocess.run([folder / "c++", "--version"], capture_output=True, text=True, check=False)
        assert "clang" in completed.stdout or "ziglang" in completed.stderr
