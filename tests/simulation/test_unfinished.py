"""What a dead run left of its recording: told from older results, kept by the next run, and ours alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import Constant, Swing

import ffsms_pin as ffsms
from ffsms_pin import files
from ffsms_pin.control import SlidingModeController
from ffsms_pin.errors import FfsmsError, ResultError, SimulationDiverged, SimulationStopped
from ffsms_pin.simulation import Tracking, Watchdog, simulate
from ffsms_pin.simulation.streaming import RowStream, part_folder

Refused = Callable[..., FfsmsError]
KILLED = """
import os, sys
sys.path.insert(0, {folder!r})
from motions import Swing
import ffsms_pin as ffsms

class Killed(Swing):
    calls = -1  # one asks where it starts

    def sample(self, t):
        if self.calls == {rows}:
            os.kill(os.getpid(), 9)
        self.calls += 1
        return super().sample(t)

sms = ffsms.load("planar_3r")
ffsms.simulate(sms, Killed(sms), ffsms.SlidingModeController(sms), stream={path!r})
"""


def killed_run(path: Path, rows: int) -> None:
    """A run of two seconds to `path`, killed after so many rows of 2001."""
    code = KILLED.format(folder=str(Path(__file__).parents[1]), path=str(path), rows=rows)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=300)
    assert done.returncode == -9, done.stderr


def test_a_killed_run_over_an_older_result(
    planar: ffsms.SpaceManipulator, swing: Swing, swung: Tracking, tmp_path: Path
) -> None:
    path, controller = tmp_path / "x.npz", SlidingModeController(planar)
    simulate(planar, swing, controller, dt=0.01, stream=path)
    killed_run(path, 1001)
    with pytest.raises(ResultError) as caught:
        Tracking.load(path)
    told = str(caught.value)
    assert f"load '{path}.part'" in told
    assert "complete=True" in told
    partial, older = Tracking.load(f"{path}.part"), Tracking.load(path, complete=True)
    assert "interrupted" in partial.note
    assert len(partial.t) == 1001
    np.testing.assert_array_equal(partial.q, swung.q[:1001])
    assert (len(older.t), older.note) == (201, "")

    # Starting again keeps what was recorded, and says where; again and again.
    killed_run(path, 501)
    assert len(Tracking.load(f"{path}.part-1").t) == 1001
    assert len(Tracking.load(f"{path}.part").t) == 501
    again = simulate(planar, swing, controller, stream=path)
    assert f"{path}.part-2" in again.note
    assert len(Tracking.load(f"{path}.part-2").t) == 501
    assert len(Tracking.load(f"{path}.part-1").t) == 1001
    assert not Path(f"{path}.part").exists()
    np.testing.assert_array_equal(Tracking.load(path).q, swung.q)


def test_a_run_that_ended_before_its_first_row_leaves_nothing_to_keep(
    planar: ffsms.SpaceManipulator, swing: Swing, tmp_path: Path
) -> None:
    path = tmp_path / "x.npz"
    simulate(planar, swing, SlidingModeController(planar), dt=0.01, stream=path)
    killed_run(path, 0)
    assert part_folder(path).is_dir()
    assert len(Tracking.load(path).t) == 201  # nothing newer was recorded
    with pytest.raises(ResultError, match="before its first row"):
        Tracking.load(part_folder(path))
    assert simulate(planar, swing, SlidingModeController(planar), dt=0.01, stream=path).note == ""
    assert os.listdir(tmp_path) == ["x.npz"]


@pytest.mark.parametrize("what", ["folder", "file", "link"])
def test_a_part_that_is_not_ours_is_not_touched(
    planar: ffsms.SpaceManipulator, swing: Swing, tmp_path: Path, refused: Refused, what: str
) -> None:
    path, mine = tmp_path / "x.npz", tmp_path / "x.npz.part"
    controller = SlidingModeController(planar)
    simulate(planar, swing, controller, dt=0.01, stream=path)
    if what == "file":
        mine.write_text("mine")
    else:
        folder = tmp_path / "elsewhere" if what == "link" else mine
        folder.mkdir()
        np.save(folder / "rows.npy", np.array([7]))
        if what == "link":
            mine.symlink_to(folder)
    before = sorted(tmp_path.rglob("*"))
    refused(
        lambda: simulate(planar, swing, controller, stream=path), ResultError, "x.npz.part", "move it away"
    )
    assert sorted(tmp_path.rglob("*")) == before
    assert len(Tracking.load(path).t) == 201  # it has nothing to do with the result either
    refused(lambda: Tracking.load(mine), ResultError)


def test_a_run_that_fails_at_its_start_leaves_nothing(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    class Late(Swing):
        calls = 0

        def sample(self, t: float) -> Any:
            self.calls += 1
            if self.calls > 1:  # one asks where it starts
                raise RuntimeError("no sample")
            return super().sample(t)

    with pytest.raises(RuntimeError, match="no sample"):
        simulate(planar, Late(planar), SlidingModeController(planar), stream=tmp_path / "x.npz")
    assert os.listdir(tmp_path) == []


def test_two_runs_do_not_record_to_one_file(tmp_path: Path, refused: Refused) -> None:
    with RowStream(tmp_path / "x.npz") as rows:
        rows.empty("q", (3, 2))
        refused(lambda: RowStream(tmp_path / "x.npz"), ResultError, "recorded by another run")
        rows.added(0)
    with RowStream(tmp_path / "x.npz") as second:
        assert second.set_aside == tmp_path / "x.npz.part-1"
    assert rows.folder == second.folder


def test_a_link_is_followed(planar: ffsms.SpaceManipulator, swing: Swing, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "x.npz").symlink_to(tmp_path / "there" / "y.npz")
    killed_run(tmp_path / "x.npz", 1001)
    assert os.listdir(tmp_path / "there") == ["y.npz.part"]
    assert len(Tracking.load(tmp_path / "x.npz").t) == 1001
    shutil.rmtree(tmp_path / "there" / "y.npz.part")
    simulate(planar, swing, SlidingModeController(planar), dt=0.01, stream=tmp_path / "x.npz")
    assert (tmp_path / "x.npz").is_symlink()
    assert len(Tracking.load(tmp_path / "there" / "y.npz").t) == 201


def test_a_disk_without_room_is_found_out_before_the_run(
    planar: ffsms.SpaceManipulator, swing: Swing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "x.npz"
    simulate(planar, swing, SlidingModeController(planar), dt=0.01, stream=path)
    before = path.read_bytes()

    class Never(Swing):
        def sample(self, t: float) -> Any:
            if t > 0.0:
                pytest.fail("the run has begun")
            return super().sample(t)

    def room(place: Any) -> Any:  # for the rows, and not for the result beside them
        return shutil._ntuple_diskusage(10**9, 10**9 - 200_000, 200_000)

    monkeypatch.setattr(shutil, "disk_usage", room)
    with pytest.raises(ResultError, match=r"cannot be written \(it needs about .* but only 0.2 MB are free"):
        simulate(planar, Never(planar), SlidingModeController(planar), stream=path)
    assert os.listdir(tmp_path) == ["x.npz"]
    assert path.read_bytes() == before


def test_a_disk_that_fills_up_meanwhile_costs_no_row(
    planar: ffsms.SpaceManipulator, swing: Swing, swung: Tracking, tmp_path: Path
) -> None:
    path = tmp_path / "x.npz"

    class Full(Swing):
        def sample(self, t: float) -> Any:
            if t == self.duration:  # nothing can be written in place of the result
                path.mkdir()
            return super().sample(t)

    with pytest.raises(ResultError, match=r"is a folder.*; the recording is in .*x\.npz\.part"):
        simulate(planar, Full(planar), SlidingModeController(planar), stream=path)
    np.testing.assert_array_equal(Tracking.load(part_folder(path)).q, swung.q)


# -- the watchdog's file ----------------------------------------------------------------------------


def test_a_watchdog_that_cannot_write_is_found_out_before_the_run(
    planar: ffsms.SpaceManipulator, tmp_path: Path, refused: Refused
) -> None:
    class Never(Constant):
        def torque(self, *arguments: Any) -> Any:
            pytest.fail("the run has begun")

    os.mkfifo(tmp_path / "pipe")
    for path, word in (
        (tmp_path / "nowhere" / "x.npz", "cannot be written"),
        (tmp_path, "is a folder"),
        (tmp_path / "pipe", "is a pipe"),
        (Path("/dev/null"), "is a device"),
    ):
        watchdog = Watchdog(path=path)
        call = lambda watchdog=watchdog: simulate(  # noqa: E731
            planar, Swing(planar), Never([0.0] * 3), watchdog=watchdog
        )
        refused(call, ResultError, word)
    assert os.listdir(tmp_path) == ["pipe"]


@pytest.mark.parametrize("torque", [0.0, np.nan])
def test_a_watchdog_that_cannot_write_any_more_brings_the_recording(
    planar: ffsms.SpaceManipulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, torque: float
) -> None:
    def full(path: Any, kind: str, values: Any) -> None:
        raise ResultError(path, "cannot be written (No space left on device)")

    monkeypatch.setattr("ffsms_pin.simulation.tracking.save_arrays", full)
    watchdog = Watchdog(joint_error=1e-3, path=tmp_path / "x.npz")
    with pytest.raises((SimulationStopped, SimulationDiverged)) as caught:
        simulate(planar, Swing(planar), Constant([torque] * 3), watchdog=watchdog)
    error: Any = caught.value
    assert type(error) is (SimulationDiverged if np.isnan(torque) else SimulationStopped)
    assert len(error.tracking.t) >= 1
    assert "error's `tracking` only" in str(error)
    assert "No space left" in str(error)
    monkeypatch.undo()
    error.tracking.save(tmp_path / "x.npz")
    assert len(Tracking.load(tmp_path / "x.npz").t) == len(error.tracking.t)


def test_the_check_leaves_nothing_behind(tmp_path: Path) -> None:
    files.check_writable(tmp_path / "x.npz")
    assert os.listdir(tmp_path) == []
