"""Test that misspelt names are reported by mypy, and by Python with a hint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mypy import api

import ffsms_pin as ffsms

ROOT = Path(__file__).parents[1]
LINES = (
    "import ffsms_pin as ffsms\nffsms.simulate\nffsms.simulte\nffsms.opt.plan\nffsms.opt.plann\n"
    "ffsms.opt\nffsms.optt\n"
)


@pytest.mark.slow  # fast with the cache that `make test` leaves; without it, mypy checks the whole library
def test_mypy_reports_misspelt_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "user.py"
    path.write_text(LINES)
    monkeypatch.setenv("MYPYPATH", str(ROOT))
    options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
    output, errors, _ = api.run([*options, str(path)])
    assert not errors
    lines = [line.split(":")[1] for line in output.splitlines() if "[attr-defined]" in line]
    assert lines == ["3", "5", "7"], output


def test_attribute_errors_allow_python_to_suggest_a_name() -> None:
    library: Any = ffsms
    with pytest.raises(AttributeError, match="simulte") as caught:
        library.simulte  # noqa: B018 - the access is the test
    assert (caught.value.name, caught.value.obj) == ("simulte", ffsms)
