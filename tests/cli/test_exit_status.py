"""Test the error line and the exit status of commands."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from scenario_files import IN_DEGREES

from ffsms_pin.cli import info, main
from ffsms_pin.errors import InvalidValue

LONG = f"{IN_DEGREES.lstrip()}[plan]\nduration = 300.0\ndt = 0.0005\n"


def ends_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> int:
    """Return the exit status of a command that raises an error."""

    def run(arguments: argparse.Namespace) -> int:
        raise error

    monkeypatch.setattr(info, "run", run)
    return main(["info", "planar_3r"])


@pytest.mark.parametrize(
    ("error", "status", "fragment"),
    [
        (InvalidValue("x", 3, "must be two"), 2, "error: x must be two, got 3"),
        (MemoryError(), 2, "error: out of memory"),
        (ZeroDivisionError("division\nby zero"), 70, "a defect of ffsms-pin, please report it: Zero"),
        (AssertionError(), 70, "a defect of ffsms-pin, please report it: AssertionError"),
        (OverflowError("too large"), 70, "too large"),
        (KeyError("key"), 70, "KeyError: 'key'"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_errors_print_one_line_and_set_the_exit_status(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    status: int,
    fragment: str,
) -> None:
    monkeypatch.delenv("FFSMS_PIN_TRACEBACK", raising=False)
    assert ends_with(monkeypatch, error) == status
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("ffsms-pin: ")
    assert captured.err.count("\n") == 1
    assert fragment in captured.err


def test_a_traceback_is_printed_on_request(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FFSMS_PIN_TRACEBACK", "1")
    assert ends_with(monkeypatch, ZeroDivisionError("here")) == 70
    printed = capsys.readouterr().err
    assert "Traceback" in printed
    assert printed.splitlines()[-1].startswith("ffsms-pin: a defect of ffsms-pin")


def test_signal_handlers_are_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []

    def run(arguments: argparse.Namespace) -> int:
        seen.append(signal.getsignal(signal.SIGTERM))
        return 0

    monkeypatch.setattr(info, "run", run)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert main(["info", "planar_3r"]) == 0
    assert callable(seen[0])
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL

    # A custom handler stays, and a command in a thread, which cannot set handlers, also works.
    def mine(*_: object) -> None:
        """Do nothing."""

    signal.signal(signal.SIGTERM, mine)
    try:
        assert main(["info", "planar_3r"]) == 0
        assert seen[1] is mine
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    thread = threading.Thread(target=lambda: seen.append(main(["info", "planar_3r"])))
    thread.start()
    thread.join()
    assert seen[-1] == 0


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("sent", "status", "word"), [("SIGTERM", 143, "terminated"), ("SIGINT", 130, "interrupted")]
)
def test_a_run_is_ended_by_a_signal(tmp_path: Path, sent: str, status: int, word: str) -> None:
    (tmp_path / "long.toml").write_text(LONG)
    process = subprocess.Popen(
        [sys.executable, "-m", "ffsms_pin", "run", "long.toml"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: [
            signal.signal(handled, signal.SIG_DFL) for handled in (signal.SIGINT, signal.SIGTERM)
        ],
    )
    try:
        deadline = time.monotonic() + 60.0
        while not (tmp_path / "results").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.3)
        process.send_signal(getattr(signal, sent))
        out, err = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == status
    *stages, last = err.splitlines()
    assert all(line.startswith("planning: ") for line in stages)  # planning may have finished
    assert last.startswith(f"ffsms-pin: {word}")
    assert out == ""
    assert os.listdir(tmp_path) == ["long.toml"]
