"""List the tests with the longest CPU time, including child processes; a plugin of pytest.

    PYTHONPATH=tests python -m pytest -n auto -p slowest

CPU time depends less on the load of the machine than wall time (`--durations`). A fixture that several tests
share counts for the first of them.
"""

from __future__ import annotations

import os
from collections.abc import Generator
from typing import Any

import pytest

_SHOWN = 20
_times: dict[str, float] = {}


def _spent() -> float:
    """Return the CPU time of this process and of its ended child processes [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    """Store the CPU time before a test's fixtures."""
    item.stash[_BEFORE] = _spent()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Add the CPU time to the report of the teardown, which may go to another process."""
    report = yield
    if report.when == "teardown":
        report.user_properties = [*report.user_properties, ("cpu", _spent() - item.stash[_BEFORE])]
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect the times in the process that prints the table."""
    if report.when == "teardown":
        _times[report.nodeid] = float(str(dict(report.user_properties).get("cpu", 0.0)))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print the table."""
    terminalreporter.section(f"slowest {_SHOWN} tests by CPU time [s]")
    for name in sorted(_times, key=lambda name: -_times[name])[:_SHOWN]:
        terminalreporter.write_line(f"{_times[name]:7.1f}  {name}")
    terminalreporter.write_line(f"{sum(_times.values()):7.1f}  all {len(_times)}")


_BEFORE = pytest.StashKey[float]()
