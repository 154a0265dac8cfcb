"""The engine: the same files whatever the workers, the shards, the order and the deaths on the way."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine_work import Draws, lost

import ffsms_pin.engine.cluster as cluster_module
from ffsms_pin.engine import ChunkFolder, Chunks, Shard, run
from ffsms_pin.errors import ClusterError, DependencyMissing, FfsmsError, InvalidValue, ResultError, TaskError

CHUNKS = Chunks(rows=22, size=4)
SPECIFICATION = {"seed": 1, "of": "tests"}


def made(folder: Path, work: Draws | None = None, **options: Any) -> ChunkFolder:
    return run(work or Draws(), CHUNKS, folder, specification=SPECIFICATION, lost=lost, **options)


def contents(folder: ChunkFolder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder.path / "chunks").iterdir()}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> ChunkFolder:
    return made(tmp_path_factory.mktemp("plain") / "run", jobs=1)


def test_the_rows_of_all_chunks(plain: ChunkFolder) -> None:
    tables = list(plain.tables())
    assert [len(table["row"]) for table in tables] == [4, 4, 4, 4, 4, 2]
    rows = np.concatenate([table["row"] for table in tables])
    np.testing.assert_array_equal(rows, np.arange(22))
    by_hand = [np.random.default_rng(row).normal() for row in range(22)]
    np.testing.assert_array_equal(np.concatenate([table["x"] for table in tables]), by_hand)
    assert plain.specification == SPECIFICATION
    assert plain.chunks == CHUNKS


def test_workers_change_nothing(plain: ChunkFolder, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    spread = made(tmp_path / "run", jobs=2, progress=lambda done, total: told.append((done, total)))
    assert contents(spread) == contents(plain)
    assert told[0] == (0, 22)
    assert told[-1] == (22, 22)
    assert told == sorted(told)


def test_shards_change_nothing(plain: ChunkFolder, tmp_path: Path) -> None:
    for number in (3, 1):
        found = made(tmp_path / "run", shard=Shard(number, 3))
    assert found.missing() == [1, 4]
    with pytest.raises(ResultError, match=r"lacks 2 of 6 chunks, the first is 1"):
        found.tables()
    assert sum(len(table["row"]) for table in found.tables(partial=True)) == 14
    made(tmp_path / "run", shard=Shard(2, 3))
    assert contents(found) == contents(plain)


def test_only_what_is_missing_is_computed_again(plain: ChunkFolder, tmp_path: Path) -> None:
    found = made(tmp_path / "run", jobs=1)
    kept = found.file(0).stat().st_mtime_ns
    found.file(2).unlink()
    told: list[tuple[int, int]] = []
    made(tmp_path / "run", jobs=1, progress=lambda done, total: told.append((done, total)))
    assert told == [(18, 22), (22, 22)]
    assert found.file(0).stat().st_mtime_ns == kept
    assert contents(found) == contents(plain)


def _damaged(found: ChunkFolder) -> None:
    file = found.file(2)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def _swapped(found: ChunkFolder) -> None:
    first, second = found.file(1).read_bytes(), found.file(2).read_bytes()
    found.file(1).write_bytes(second)
    found.file(2).write_bytes(first)


def _of_another_run(found: ChunkFolder) -> None:
    other = run(
        Draws(), CHUNKS, found.path.parent / "other", specification={**SPECIFICATION, "seed": 2}, jobs=1
    )
    found.file(2).write_bytes(other.file(2).read_bytes())


@pytest.mark.parametrize("spoil", [_damaged, _swapped, _of_another_run])
def test_a_chunk_that_is_no_evidence_is_computed_again(
    plain: ChunkFolder, tmp_path: Path, spoil: Callable[[ChunkFolder], None]
) -> None:
    found = made(tmp_path / "run", jobs=1)
    spoil(found)
    with pytest.raises(ResultError, match=r"chunks/0000000[12]\.npz"):
        list(found.tables())
    made(tmp_path / "run", jobs=1)
    assert contents(found) == contents(plain)


def test_a_folder_goes_on_where_a_file_was_moved(tmp_path: Path) -> None:
    options: dict[str, Any] = {"specification": SPECIFICATION, "jobs": 1}
    found = run(Draws(), CHUNKS, tmp_path / "run", where={"source": "/here/a.toml"}, **options)
    written = found.file(0).stat().st_mtime_ns
    again = run(Draws(), CHUNKS, tmp_path / "run", where={"source": "/there/a.toml"}, **options)
    assert found.file(0).stat().st_mtime_ns == written
    assert again.where == {"source": "/there/a.toml"}


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_is_to_be_prepared_stands_before_the_first_chunk(tmp_path: Path, jobs: int) -> None:
    file = tmp_path / "prepared"
    calls: list[int] = []

    def prepare() -> None:
        calls.append(1)
        file.write_text("2.0")

    def work(rows: range) -> dict[str, np.ndarray]:
        return {"x": np.full(len(rows), float(file.read_text()))}

    for _ in range(2):  # the second time all chunks are there
        found = run(work, Chunks(4, 1), tmp_path / "run", specification={}, jobs=jobs, prepare=prepare)
    assert calls == [1]
    assert [float(table["x"][0]) for table in found.tables()] == [2.0] * 4


def test_another_specification_is_refused(tmp_path: Path) -> None:
    made(tmp_path / "run", jobs=1)
    with pytest.raises(ResultError, match=r"another specification \(seed is 1 there and 2 here\)"):
        run(Draws(), CHUNKS, tmp_path / "run", specification={**SPECIFICATION, "seed": 2}, jobs=1)
    with pytest.raises(ResultError, match=r"rows is 22 there and 23 here"):
        run(Draws(), Chunks(23, 4), tmp_path / "run", specification=SPECIFICATION, jobs=1)


def test_a_row_that_kills_its_worker_is_found_and_told(plain: ChunkFolder, tmp_path: Path) -> None:
    found = made(tmp_path / "run", Draws(killer=9), jobs=2, allowed_failures=0)
    for table, wanted in zip(found.tables(), plain.tables(), strict=True):
        others = table["row"] != 9
        np.testing.assert_array_equal(table["row"], wanted["row"])
        np.testing.assert_array_equal(table["x"][others], wanted["x"][others])
        assert (table["error"] == np.where(others, "", "killed its worker")).all()


def test_an_error_of_the_work_ends_the_run(tmp_path: Path) -> None:
    for jobs, kind in ((1, ZeroDivisionError), (2, TaskError)):
        with pytest.raises(kind, match="nothing to divide by"):
            made(tmp_path / "run", Draws(wrong=9), jobs=jobs)
    assert 2 not in ChunkFolder(tmp_path / "run").done()


def test_a_table_that_is_none(tmp_path: Path) -> None:
    def short(rows: range) -> dict[str, Any]:
        return {"x": np.zeros(len(rows) + 1)}

    with pytest.raises(TaskError, match=r"column 'x' of rows 0 to 3 has shape \(5,\)"):
        run(short, CHUNKS, tmp_path / "run", specification={}, jobs=1)


def test_a_scheduler_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "_CONNECTING", 0.3)
    with pytest.raises(ClusterError, match=r"no scheduler answers at tcp://127.0.0.1:1; start one"):
        made(tmp_path / "run", scheduler="tcp://127.0.0.1:1")


def test_workers_that_cannot_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "_BOOT", "print('no such thing'); raise SystemExit(71)")
    with pytest.raises(ClusterError, match="the workers do not start: no such thing"):
        made(tmp_path / "run", jobs=2)


def test_without_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DependencyMissing, match=r"pip install 'ffsms-pin\[cluster\]'"):
        made(tmp_path / "two", jobs=2)
    made(tmp_path / "one", jobs=1)
    monkeypatch.setitem(sys.modules, "dask.system", None)
    assert cluster_module.usable_cores() == 1
    monkeypatch.delitem(sys.modules, "distributed")
    monkeypatch.setitem(sys.modules, "dask", None)  # one package of the extra is enough to lack
    assert cluster_module.usable_cores() == 1


def test_folders_that_cannot_be_used(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(ResultError, match="cannot be written"):
        made(file / "run", jobs=1)
    with pytest.raises(ResultError, match="holds no results"):
        ChunkFolder(tmp_path).tables()
    found = made(tmp_path / "run", jobs=1)
    specification = tmp_path / "run" / "specification.json"
    specification.write_text(json.dumps({**json.loads(specification.read_text()), "rows": 23}))
    with pytest.raises(ResultError, match="no specification that this version wrote"):
        found.tables()


def test_a_full_disk_is_one_line(plain: ChunkFolder, tmp_path: Path) -> None:
    """The system lets no file of a worker grow. What is written stays; with room, the run goes on."""
    with pytest.raises(ResultError, match=r"00000002.npz: cannot be written \(File too large\)"):
        made(tmp_path / "run", Draws(full=9), jobs=2)
    found = ChunkFolder(tmp_path / "run")
    # The other worker is killed, maybe while it writes its own chunk: the next run removes what it leaves.
    assert not [name for name in contents(found) if "00000002" in name]
    assert sum(1 for _ in found.tables(partial=True)) == len(found.done())
    made(tmp_path / "run", jobs=1)
    assert contents(found) == contents(plain)
    # One worker alone leaves nothing half written at all.
    found.file(2).unlink()
    with pytest.raises(ResultError, match=r"00000002.npz: cannot be written \(File too large\)"):
        made(tmp_path / "run", Draws(full=9), jobs=2)
    assert all(path.suffix == ".npz" for path in found.file(2).parent.iterdir())
    assert found.missing() == [2]


def test_arguments_that_do_not_fit(tmp_path: Path, refused: Callable[..., FfsmsError]) -> None:
    refused(lambda: Chunks(0, 4), InvalidValue, "rows")
    refused(lambda: Chunks(10**9, 1), InvalidValue, "size")
    refused(lambda: Chunks(10**100, 2), InvalidValue, "size")
    refused(lambda: Shard(3, 2), InvalidValue, "shard")
    refused(lambda: Shard.read("3-16"), InvalidValue, "shard")
    assert Shard.read("3/16") == Shard(3, 16)
    refused(lambda: made(tmp_path, jobs=0), InvalidValue, "jobs")
    refused(lambda: made(tmp_path, jobs=5000), InvalidValue, "jobs")
    refused(lambda: made(tmp_path, scheduler="somewhere"), InvalidValue, "scheduler")
    refused(lambda: made(tmp_path, scheduler="tcp://a:1", shard=Shard(1, 2)), InvalidValue, "shard")
    refused(
        lambda: run(Draws(), CHUNKS, tmp_path, specification={"x": np.nan}), InvalidValue, "specification"
    )
