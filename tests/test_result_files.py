"""Test that damaged, foreign and malicious result files cause one error and no harm."""

from __future__ import annotations

import io
import os
import tempfile
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import files, opt
from ffsms_pin.errors import FfsmsError, ResultError
from ffsms_pin.simulation import Tracking

Refused = Callable[..., FfsmsError]
GIGABYTES = 3 * 10**9


@pytest.fixture(scope="module")
def plan(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    q0 = planar.configuration([0.3, 0.6, 0.5])
    return opt.plan(planar, q0, [0.7, 0.3, 0.0], 2.0, 0.1, method="step")


def arrays_in(result: Any) -> dict[str, Any]:
    """Return the arrays that `save` writes for a plan or a recording."""
    with tempfile.TemporaryDirectory() as folder:
        result.save(Path(folder) / "saved.npz")
        with np.load(Path(folder) / "saved.npz") as arrays:
            return dict(arrays)


def written(path: Path, values: dict[str, Any]) -> Path:
    np.savez_compressed(path, **values)
    return path


def bomb(path: Path, values: dict[str, Any], name: str, size: int = GIGABYTES) -> Path:
    """Write a file in which the header of one member declares `size` bytes of zeros."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, value in values.items():
            buffer = io.BytesIO()
            if key == name:
                head = {"descr": "<f8", "fortran_order": False, "shape": (size // 8,)}
                np.lib.format.write_array_header_1_0(buffer, head)
            else:
                np.lib.format.write_array(buffer, np.asarray(value))
            archive.writestr(f"{key}.npy", buffer.getvalue())
            if key == name:
                archive.filelist[-1].file_size += size  # the size that a reader uses
    return path


@pytest.mark.parametrize("load", [Tracking.load, opt.Trajectory.load])
def test_a_member_that_would_unpack_to_gigabytes_is_not_read(
    load: Callable[[Path], Any], plan: opt.Trajectory, swung: Tracking, tmp_path: Path, refused: Refused
) -> None:
    values = arrays_in(plan if load == opt.Trajectory.load else swung)
    for name in ("q", "t"):
        path = bomb(tmp_path / "bomb.npz", values, name)
        assert path.stat().st_size < 2_000_000
        tracemalloc.start()
        refused(lambda path=path: load(path), ResultError, "bomb.npz", "would unpack to 3 GB")
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert most < 10_000_000
    # Members that do not belong to a result are not read.
    path = bomb(tmp_path / "more.npz", {**values, "more": 0}, "more")
    np.testing.assert_array_equal(load(path).t, values["t"])


def test_highly_compressed_zeros_are_refused_for_their_size(
    swung: Tracking, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Test files with consistent shapes: one of zeros, which is refused, and a recording, which is loaded."""
    N = 50_000
    rows = {name: value.shape[1:] for name, value in arrays_in(swung).items() if value.shape}
    values: dict[str, Any] = {name: np.zeros((N, *shape)) for name, shape in rows.items()}
    steps = ("tau", "wheel_torque", "thruster_force")
    values |= {name: np.zeros((N - 1, *rows[name])) for name in steps} | {"t": np.arange(float(N))}
    single = {name: value for name, value in arrays_in(swung).items() if not value.shape}
    path = written(tmp_path / "zeros.npz", {**single, **values})
    assert len(Tracking.load(path).t) == N
    monkeypatch.setattr(files, "_UNPACKED", 10**6)
    refused(lambda: Tracking.load(path), ResultError, "more than any recording")
    swung.save(tmp_path / "whole.npz")  # also larger than the limit, but not highly compressed
    assert sum(np.asarray(value).nbytes for value in arrays_in(swung).values()) > 10**5
    monkeypatch.setattr(files, "_UNPACKED", 10**5)
    assert len(Tracking.load(tmp_path / "whole.npz").t) == len(swung.t)


def test_a_wrong_array_header_is_refused(swung: Tracking, tmp_path: Path, refused: Refused) -> None:
    values = arrays_in(swung)
    for shape in ((10**9,), (2, 3), (-1, -2), (10**30,), (0,)):
        path = tmp_path / "lie.npz"
        with zipfile.ZipFile(path, "w") as archive:
            for key, value in values.items():
                with archive.open(f"{key}.npy", "w") as member:
                    if key == "work":
                        head = {"descr": "<f8", "fortran_order": False, "shape": shape}
                        np.lib.format.write_array_header_1_0(member, head)
                        member.write(bytes(24))
                    else:
                        np.lib.format.write_array(member, np.asarray(value))
        refused(lambda path=path: Tracking.load(path), ResultError, "lie.npz")


def test_objects_and_code_are_not_read(swung: Tracking, tmp_path: Path, refused: Refused) -> None:
    class Harm:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / "harm"),)

    values = arrays_in(swung)
    for name in ("q", "format", "note"):
        path = written(tmp_path / "harm.npz", {**values, name: np.array([Harm()], dtype=object)})
        refused(lambda path=path: Tracking.load(path), ResultError, "not an npz file")
    more = written(tmp_path / "more.npz", {**values, "more": np.array([Harm()], dtype=object)})
    Tracking.load(more)  # a foreign member is not read
    assert not (tmp_path / "harm").exists()


def test_pipes_and_devices_are_no_result_files(tmp_path: Path, refused: Refused) -> None:
    os.mkfifo(tmp_path / "pipe")
    refused(lambda: Tracking.load(tmp_path / "pipe"), ResultError, "not a regular file")
    refused(lambda: opt.Trajectory.load(Path("/dev/zero")), ResultError, "not a regular file")


def test_a_plan_with_inconsistent_arrays_is_refused(
    plan: opt.Trajectory, tmp_path: Path, refused: Refused
) -> None:
    values, path = arrays_in(plan), tmp_path / "plan.npz"
    plan.save(path)
    again = opt.Trajectory.load(path)
    for name, value in arrays_in(again).items():
        np.testing.assert_array_equal(value, values[name], err_msg=name)

    def changed(name: str, value: Any, fragment: str) -> None:
        written(path, {**values, name: value})
        refused(lambda: opt.Trajectory.load(path), ResultError, "plan.npz", fragment)

    numbers = [name for name, value in values.items() if name != "format" and value.dtype.kind == "f"]
    assert len(numbers) >= 18
    for name in numbers:
        fewer = values[name][:-1] if values[name].shape else np.zeros(2)
        if name != "t":  # the shapes of the others are compared with it
            changed(name, fewer, f"holds {name} of shape")
        changed(name, values[name][np.newaxis], f"holds {name} of shape")
        changed(name, np.full(values[name].shape, "x"), f"holds no numbers in {name}")
    changed("t", values["t"][:-1], "holds v of shape")
    changed("t", values["t"][:0], "holds t of shape (0,)")
    changed("t", values["t"][::-1], "do not increase")
    changed("t", np.full_like(values["t"], np.nan), "do not increase")
    changed("q", values["q"][:, :9], "holds q of shape (21, 9) where 10 to 13 columns would fit")
    single = {
        name: value[: len(value) - 20]
        for name, value in values.items()
        if len(value.shape) > 0 and len(value) > 19
    }
    written(path, {**values, **single})
    refused(lambda: opt.Trajectory.load(path), ResultError, "holds 1 instants in t where at least 2")
    changed("clear", np.array("yes"), "holds no truth value in clear")
    changed("clear", np.array([True, False]), "holds clear of shape (2,)")
    changed("note", np.array(3.0), "holds no text in note")
    changed("kappa", np.array(True), "holds no numbers in kappa")


def test_a_recording_with_times_that_do_not_increase_is_refused(
    swung: Tracking, tmp_path: Path, refused: Refused
) -> None:
    for t in (swung.t[::-1], np.zeros_like(swung.t), np.full_like(swung.t, np.inf)):
        path = written(tmp_path / "t.npz", {**arrays_in(swung), "t": t})
        refused(lambda path=path: Tracking.load(path), ResultError, "do not increase")


def test_a_file_too_large_for_memory_is_refused(
    swung: Tracking, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none_left(*arguments: Any, **options: Any) -> None:
        raise MemoryError

    swung.save(tmp_path / "x.npz")
    monkeypatch.setattr(np, "load", none_left)
    refused(lambda: Tracking.load(tmp_path / "x.npz"), ResultError, "too large for this machine's memory")


def test_numbers_by_name(refused: Refused) -> None:
    assert files.numbers_by_name("x", "shares", '{"a": 1, "b": 2.5}') == {"a": 1.0, "b": 2.5}
    rows = files.numbers_by_name("x", "binding", '{"a": [1, 2.5], "b": []}', rows=True)
    assert {name: row.tolist() for name, row in rows.items()} == {"a": [1.0, 2.5], "b": []}
    for text in ("", "[]", "3", '{"a": "b"}', '{"a": [[1]]}', '{"a": true}', "[" * 100_000, "{" * 9):
        for in_rows in (False, True):
            read = lambda text=text, rows=in_rows: files.numbers_by_name("x", "shares", text, rows)  # noqa: E731
            refused(read, ResultError, "x: holds no JSON object of numbers in shares")
    refused(lambda: files.numbers_by_name("x", "shares", '{"a": [1.0]}'), ResultError, "shares")
    refused(lambda: files.numbers_by_name("x", "binding", '{"a": 1.0}', rows=True), ResultError, "binding")
