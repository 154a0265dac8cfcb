"""Recordings that go to disk as they come: the same bits, bounded memory, readable after an interruption."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.control import SlidingModeController
from ffsms_pin.errors import InvalidValue, ResultError, SimulationStopped
from ffsms_pin.simulation import Capture, Tracking, Watchdog, simulate
from ffsms_pin.simulation.streaming import RowStream, part_folder

Array = NDArray[np.float64]


class Sway:
    """Joints that sway for ever: a reference that takes no memory."""

    def __init__(self, sms: ffsms.SpaceManipulator, duration: float, stop_at: float = np.inf) -> None:
        self.duration, self.stop_at = duration, stop_at
        self.q = sms.configuration(np.zeros(sms.n))[np.newaxis]
        self.target: Any = np.array([0.5, 0.5, 0.0])
        self.size = 0.2 * np.ones(sms.n)

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Joint motion at t."""
        if t > self.stop_at:
            raise KeyboardInterrupt
        return self.size * np.sin(t), self.size * np.cos(t), -self.size * np.sin(t)


def same(a: Tracking, b: Tracking) -> bool:
    """Equal to the last bit."""
    arrays = [field.name for field in fields(Tracking) if field.name != "note"]
    pairs = [(getattr(a, name), getattr(b, name)) for name in arrays]
    return all(x.shape == y.shape and x.tobytes() == y.tobytes() for x, y in pairs) and a.note == b.note


def test_a_streamed_run_is_the_same_run(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    path, controller = tmp_path / "run.npz", SlidingModeController(planar)
    # 9000 steps: two blocks and a part of a third.
    how: dict[str, Any] = {"events": Capture(8.4, 5.0, 0.1 * np.eye(3))}
    expected = simulate(planar, Sway(planar, 9.0), controller, **how)
    streamed = simulate(planar, Sway(planar, 9.0), controller, **how, stream=path)
    assert expected.note
    assert same(streamed, expected)
    assert isinstance(streamed.q, np.memmap)
    assert not streamed.q.flags.writeable
    assert streamed.energy_error.max() == expected.energy_error.max()
    assert same(Tracking.load(path), expected)
    assert os.listdir(tmp_path) == ["run.npz"]  # no part is left
    streamed.save(tmp_path / "again.npz")
    assert same(Tracking.load(tmp_path / "again.npz"), expected)


def test_times_are_those_of_linspace(tmp_path: Path) -> None:
    for i, (duration, steps) in enumerate([(3600.0, 10001), (0.7, 3), (12.34, 4095), (1.1, 8192)]):
        t = RowStream(tmp_path / str(i)).times(duration, steps)
        assert t.tobytes() == np.linspace(0.0, duration, steps + 1).tobytes()


def test_an_interrupted_run_leaves_its_rows(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    path, controller = tmp_path / "run.npz", SlidingModeController(planar)
    expected = simulate(planar, Sway(planar, 5.0), controller)
    with pytest.raises(KeyboardInterrupt):
        simulate(planar, Sway(planar, 5.0, stop_at=4.5), controller, stream=path)
    assert not path.exists()
    for name in (path, part_folder(path)):
        partial = Tracking.load(name)
        assert "interrupted" in partial.note
        assert len(partial.t) == 4501
        assert partial.t[-1] == 4.5
        assert np.array_equal(partial.q, expected.q[:4501])
        assert np.array_equal(partial.tau, expected.tau[:4500])
        assert np.array_equal(partial.work, expected.work[:4501])
    # What is whole stays until there is something whole to take its place.
    simulate(planar, Sway(planar, 1.0), controller, stream=path)
    assert not part_folder(path).exists()
    with pytest.raises(KeyboardInterrupt):
        simulate(planar, Sway(planar, 5.0, stop_at=2.0), controller, stream=path)
    # Nobody takes the old run for the new one.
    with pytest.raises(ResultError, match=r"load '.*run\.npz\.part' for these, or with complete=True"):
        Tracking.load(path)
    assert len(Tracking.load(path, complete=True).t) == 1001
    assert len(Tracking.load(part_folder(path)).t) == 2001


def test_a_stopped_run_is_written_whole(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    with pytest.raises(SimulationStopped) as stopped:
        simulate(
            planar,
            Sway(planar, 5.0),
            SlidingModeController(planar),
            q0=planar.configuration([0.0, 0.1, 0.0]),
            watchdog=Watchdog(joint_error=0.05),
            stream=path,
        )
    assert same(Tracking.load(path), stopped.value.tracking)


def test_a_damaged_part_and_a_folder_that_is_not_there(
    planar: ffsms.SpaceManipulator, tmp_path: Path
) -> None:
    path, controller = tmp_path / "run.npz", SlidingModeController(planar)
    with pytest.raises(InvalidValue):
        simulate(planar, Sway(planar, 1.0), controller, q0=np.zeros(3), stream=path)
    assert not part_folder(path).exists()
    with pytest.raises(ResultError, match="cannot be written"):
        simulate(planar, Sway(planar, 1.0), controller, stream=tmp_path / "none" / "run.npz")
    with pytest.raises(KeyboardInterrupt):
        simulate(planar, Sway(planar, 1.0, stop_at=0.5), controller, stream=path)
    (part_folder(path) / "q.npy").write_bytes(b"no array")
    with pytest.raises(ResultError, match="unfinished"):
        Tracking.load(path)
    (part_folder(path) / "q.npy").unlink()
    with pytest.raises(ResultError, match="lacks q"):
        Tracking.load(path)


KILLED = """
import os, sys
sys.path.insert(0, {folder!r})
from test_streaming import Sway
import ffsms_pin as ffsms

class Killed(Sway):
    def sample(self, t):
        if t > 1.5:
            os.kill(os.getpid(), 9)
        return super().sample(t)

sms = ffsms.load("planar_3r")
ffsms.simulate(sms, Killed(sms, 2.0), ffsms.SlidingModeController(sms), stream={path!r})
"""


def test_a_killed_run_leaves_its_rows(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    code = KILLED.format(folder=str(Path(__file__).parent), path=str(path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=300)
    assert done.returncode == -9, done.stderr
    partial = Tracking.load(path)
    assert len(partial.t) == 1501
    expected = simulate(planar, Sway(planar, 2.0), SlidingModeController(planar))
    assert np.array_equal(partial.q, expected.q[:1501])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_the_memory_taken_does_not_grow_with_the_run(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, {folder!r})\n"
        "from ffsms_pin.simulation.streaming import RowStream\n"
        "import numpy as np\n"
        "def taken():\n"
        "    lines = open('/proc/self/status').read().split('\\n')\n"
        "    return sum(int(line.split()[1]) for line in lines if line.startswith(('RssAnon', 'RssFile')))\n"
        "rows = RowStream({path!r})\n"
        "t = rows.times(3600.0, 400_000)\n"
        "q = rows.empty('q', (400_001, 40))\n"  # 128 MB
        "first, most = taken(), 0\n"
        "for k in range(400_001):\n"
        "    q[k] = k\n"
        "    rows.added(k)\n"
        "    if k % 20_000 == 0:\n"
        "        most = max(most, taken())\n"
        "assert q[123_456, 7] == 123_456\n"
        "print((most - first) / 1024)\n"
    ).format(folder=str(Path(__file__).parent), path=str(tmp_path / "run.npz"))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, timeout=300)
    assert float(done.stdout) < 16.0  # [MB], whatever the number of rows
