"""Test that all readers refuse devices, pipes and extremely large files."""

from __future__ import annotations

import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from scenario_files import QUICK, write as write_scenario

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.campaigns import Campaign
from ffsms_pin.cli.view import scene_of
from ffsms_pin.errors import FfsmsError, ResultError
from ffsms_pin.export import read_csv
from ffsms_pin.files import check_readable, read_content
from ffsms_pin.inspection import inspect
from ffsms_pin.robot.building import is_mjcf
from ffsms_pin.robot.mjcf import read_mjcf
from ffsms_pin.scenarios.definition import load_scenario
from ffsms_pin.simulation import Tracking
from ffsms_pin.system.urdf_elements import read_robot

HUGE = 2**40  # [bytes], a sparse file


def read_obstacle(path: Path) -> Any:
    """Read a file as the mesh of a scenario's obstacle."""
    name = f'{QUICK}\n[[obstacle]]\nshape = "mesh"\nfile = "{path}"\n'
    chosen = ffsms.scenario(write_scenario(path.parent, name))
    return chosen.obstacles(None)


def read_summary(path: Path) -> Any:
    """Read a file as the summary of results."""
    folder = path.parent / "results"
    folder.mkdir()
    planar = ffsms.load("planar_3r")
    q0 = planar.configuration([0.3, 0.6, 0.5])
    opt.plan(planar, q0, [0.7, 0.3, 0.0], 1.0, 0.1, method="step").save(folder / "trajectory.npz")
    replace_by_link(folder / "summary.json", path)
    return scene_of(folder)


def read_campaign(path: Path) -> Any:
    """Read a file as the campaign of a folder."""
    folder = path.parent / "campaign"
    folder.mkdir()
    replace_by_link(folder / "campaign.json", path)
    return Campaign.open(folder)


def replace_by_link(place: Path, path: Path) -> None:
    """Replace a file by a link to `path`."""
    place.unlink(missing_ok=True)
    place.symlink_to(path)


READERS: dict[str, Callable[[Path], Any]] = {
    "content": lambda path: with_result_error(lambda: read_content(path)),
    "robot": ffsms.load,
    "arm": ffsms.mount,
    "inspected": inspect,
    "tree": read_robot,
    "MJCF": lambda path: read_mjcf(path, whole=False, inertias="check", stacklevel=2),
    "scenario": ffsms.scenario,
    "draws": lambda path: Campaign.read(str(path), 2, None),
    "saved scenario": load_scenario,
    "CSV": lambda path: read_csv(ffsms.load("planar_3r"), path),
    "trajectory": opt.Trajectory.load,
    "tracking": Tracking.load,
    "obstacle": read_obstacle,
    "summary": read_summary,
    "campaign": read_campaign,
}


# Readers with other messages, by reader and whether the file is huge. Robots are first searched by name, and
# result files have their own checks of sizes.
OTHERWISE = {
    **dict.fromkeys(
        [(name, False) for name in ("robot", "arm", "inspected")], "neither a file nor a packaged"
    ),
    **dict.fromkeys([(name, True) for name in ("trajectory", "tracking")], "is not an npz file"),
}


def with_result_error(read: Callable[[], Any]) -> Any:
    """Call a reader, and convert an OSError to ResultError, as the callers of `read_content` do."""
    try:
        return read()
    except OSError as error:
        raise ResultError("file", f"cannot be read ({error.strerror})") from None


@pytest.mark.parametrize("kind", ["device", "pipe", "huge"])
@pytest.mark.parametrize("name", READERS)
def test_devices_pipes_and_huge_files_are_refused(name: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "given"
    if kind == "device":
        path.symlink_to("/dev/zero")  # reading never ends
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        with path.open("wb") as file:
            file.truncate(HUGE)
    with pytest.raises(FfsmsError) as caught:
        READERS[name](path)
    message = str(caught.value)
    assert "\n" not in message
    expected = "MB are read" if kind == "huge" else "it is not a regular file but a"
    assert OTHERWISE.get((name, kind == "huge"), expected) in message


def test_a_file_of_the_largest_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_content(path, 5) == b"12345"
    with pytest.raises(OSError, match="at most"):
        check_readable(path, 4)
    assert not is_mjcf(Path("/dev/zero"))


def test_reading_a_small_file_allocates_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    tracemalloc.start()
    read_content(path, 10**9)
    assert tracemalloc.get_traced_memory()[1] < 10**6
    tracemalloc.stop()
