"""Recordings of a closed loop: read-only, saved and loaded whole, and refused where they are damaged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import Constant, Swing, arrays_of

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError, SimulationDiverged
from ffsms_pin.simulation import Tracking, simulate

Refused = Callable[..., FfsmsError]


def test_tracking_is_read_only(swung: Tracking) -> None:
    with pytest.raises(ValueError, match="read-only"):
        swung.q[0, 0] = 1.0
    with pytest.raises(AttributeError):
        swung.q = swung.v  # type: ignore[misc]


def test_save_and_load_give_the_same_back(swung: Tracking, tmp_path: Path) -> None:
    path = tmp_path / "tracking.npz"
    replace(swung, note="something happened").save(path)
    assert [file.name for file in tmp_path.iterdir()] == ["tracking.npz"]
    again = Tracking.load(path)
    assert again.note == "something happened"
    for name in arrays_of(swung):
        array = getattr(again, name)
        np.testing.assert_array_equal(array, getattr(swung, name))
        assert not array.flags.writeable
    with np.load(path) as plain:  # readable without this library
        np.testing.assert_array_equal(plain["tau"], swung.tau)


def test_the_end_effector_is_that_of_the_states(swung: Tracking, planar: ffsms.SpaceManipulator) -> None:
    assert swung.end_effector.shape == (len(swung.t), 3)
    for k in (0, 11, -1):
        position = planar.at(swung.q[k]).end_effector_pose.translation
        np.testing.assert_allclose(swung.end_effector[k], position, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "fragment"),
    [
        ("flight.csv", "export.to_csv"),
        ("flight.CSV", "export.to_csv"),
        ("flight.parquet", "to_dataframe"),
        ("a.json", "npz"),
    ],
)
def test_a_name_of_another_format_is_refused(
    swung: Tracking, tmp_path: Path, refused: Refused, name: str, fragment: str
) -> None:
    refused(lambda: swung.save(tmp_path / name), InvalidValue, "must end in .npz", fragment)
    assert not list(tmp_path.iterdir())


def test_a_table_that_is_loaded_names_its_reader(tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "plan.csv").write_text("time [s]\n0\n", encoding="utf-8")
    refused(lambda: Tracking.load(tmp_path / "plan.csv"), ResultError, "export.read_csv")


def test_recording_of_a_run_that_stopped_at_once_can_be_saved(
    planar: ffsms.SpaceManipulator, swing: Swing, tmp_path: Path
) -> None:
    with pytest.raises(SimulationDiverged) as caught:
        simulate(planar, swing, Constant(np.full(3, math.nan)))
    caught.value.tracking.save(tmp_path / "none.npz")
    assert Tracking.load(tmp_path / "none.npz").tau.shape == (0, 3)


def test_bad_result_files_are_refused(swung: Tracking, tmp_path: Path, refused: Refused) -> None:
    refused(lambda: Tracking.load(tmp_path / "missing.npz"), ResultError, "no such file")
    text = tmp_path / "text.npz"
    text.write_text("not an archive")
    refused(lambda: Tracking.load(text), ResultError, "text.npz", "not an npz")
    good = tmp_path / "good.npz"
    swung.save(good)
    cut = tmp_path / "cut.npz"
    cut.write_bytes(good.read_bytes()[:2000])
    refused(lambda: Tracking.load(cut), ResultError, "not an npz")
    damaged = bytearray(good.read_bytes())
    damaged[1000:1100] = bytes(100)
    cut.write_bytes(damaged)
    refused(lambda: Tracking.load(cut), ResultError, "not an npz")
    np.save(tmp_path / "one.npy", swung.q)
    refused(lambda: Tracking.load(tmp_path / "one.npy"), ResultError, "not an npz")
    refused(lambda: Tracking.load(tmp_path), ResultError, "cannot be read")
    with np.load(good) as file:
        arrays = dict(file)

    def changed(fragment: str, **change: Any) -> None:
        path = tmp_path / "changed.npz"
        values = {name: value for name, value in {**arrays, **change}.items() if value is not None}
        np.savez(path, **values)
        refused(lambda: Tracking.load(path), ResultError, fragment)

    changed("lacks tau", tau=None)
    changed("is not a ffsms-pin tracking", format="ffsms-pin trajectory")
    changed("is not a ffsms-pin tracking", format=None)
    changed("holds v of shape", v=swung.v[:-1])
    changed("holds q of shape", q=swung.q[:, :4])
    changed("holds tau of shape", tau=swung.tau[0])
    changed("holds momentum of shape", momentum=swung.momentum[:, :3])
    changed("no numbers in work", work=np.full(len(swung.t), "much"))
    refused(lambda: swung.save(tmp_path / "nowhere" / "t.npz"), ResultError, "cannot be written")


def test_a_failed_save_leaves_the_old_file(
    swung: Tracking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "tracking.npz"
    swung.save(path)
    before = path.read_bytes()

    def full_disk(file: Any, **arrays: Any) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    with pytest.raises(ResultError, match="No space left"):
        replace(swung, work=swung.work + 1.0).save(path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["tracking.npz"]
