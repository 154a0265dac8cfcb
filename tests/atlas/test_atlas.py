"""Atlases as files: what is in them, from whole and from broken runs, on one worker and as shards."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.atlas import atlas, build, measured, open_atlas
from ffsms_pin.atlas.dataset import Cells
from ffsms_pin.cli import main
from ffsms_pin.engine import Shard, parts_folder
from ffsms_pin.errors import DependencyMissing, InvalidValue, ResultError
from ffsms_pin.plotting.atlas import plot_atlas

ROWS = 2500
DIRECTIONS = [(2.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


@pytest.fixture
def planar(monkeypatch: pytest.MonkeyPatch) -> ffsms.SpaceManipulator:
    """The paper's arm; chunks of 1,000 rows, so that a small atlas has several."""
    monkeypatch.setattr(build, "CHUNK", 1000)
    return ffsms.load("planar_3r")


def made(sms: ffsms.SpaceManipulator, out: Path, over: str = "joints", **options: Any) -> Any:
    """A small atlas, opened."""
    atlas(sms, out, ROWS, over, directions=DIRECTIONS, jobs=1, seed=3, **options)
    return open_atlas(out)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A small atlas of either kind, to read and to copy."""
    folder = tmp_path_factory.mktemp("atlases")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "CHUNK", 1000)
        for over in ("joints", "workspace"):
            made(ffsms.load("planar_3r"), folder / over, over, cells=10)
    return {over: folder / over for over in ("joints", "workspace")}


def test_rows_are_the_states_of_their_joints(planar: ffsms.SpaceManipulator, kept: dict[str, Path]) -> None:
    data = open_atlas(kept["joints"])
    assert dict(data.sizes) == {"sample": ROWS, "joint": 3, "mode": 3, "axis": 3, "direction": 2}
    assert data["entropy"].chunks == ((1000, 1000, 500),)
    for k in (0, 999, 1000, ROWS - 1):
        row = data.isel(sample=k).load()
        # The file's joints are rounded to single precision, and sensitive postures show it.
        state = planar.at(planar.configuration(row["joints"].values.astype(float)))
        np.testing.assert_allclose(row["sigma"], state.coupling.sigma, rtol=1e-4, atol=1e-6)
        assert float(row["entropy"]) == pytest.approx(state.coupling.entropy, abs=1e-5)
        position = state.base_pose.actInv(state.end_effector_pose.translation)
        np.testing.assert_allclose(row["end_effector"], position, atol=1e-6)


def test_it_says_what_it_holds_and_where_it_is_from(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    data = made(planar, tmp_path / "a.zarr", provenance={"command": "ffsms-pin atlas planar_3r"})
    assert data.attrs["model"] == "planar_3r"
    assert (data.attrs["seed"], data.attrs["samples"]) == (3, ROWS)
    assert data.attrs["source"] == f"ffsms-pin {ffsms.__version__}"
    assert data.attrs["command"] == "ffsms-pin atlas planar_3r"
    assert data["joint"].values.tolist() == planar.joint_names
    assert data["direction"].values.tolist() == ["1 0 0", "0 1 0"]
    assert {name: data[name].attrs["units"] for name in ("joints", "base_rotation", "entropy")} == {
        "joints": "rad",
        "base_rotation": "rad/m",
        "entropy": "1",
    }
    assert not list(tmp_path.glob("*.parts"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr"]


def test_the_workspace_is_the_samples_cell_by_cell(kept: dict[str, Path]) -> None:
    rows, data = (open_atlas(kept[over]).load() for over in ("joints", "workspace"))
    assert data.sizes["z"] == 1
    assert max(data.sizes["x"], data.sizes["y"]) == 10
    assert int(data["count"].sum()) == ROWS
    edge = data.attrs["cell_edge_m"]
    i, j = np.unravel_index(int(data["count"].values.argmax()), data["count"].shape[:2])
    centre = np.array([data["x"][i], data["y"][j]])
    inside = (np.abs(rows["end_effector"].values[:, :2] - centre) < 0.5 * edge).all(axis=1)
    assert inside.sum() == int(data["count"][i, j, 0])
    for name, values in (
        ("entropy", rows["entropy"].values),
        ("sigma_1", rows["sigma"].values[:, 0]),
        ("assistance_2", rows["assistance"].values[:, 1]),
    ):
        expected = [values[inside].mean(), values[inside].min(), values[inside].max()]
        np.testing.assert_allclose(data[name][:, i, j, 0], expected, rtol=1e-5)
    assert np.isnan(data["entropy"].values[:, data["count"].values == 0]).all()


def test_a_run_that_broke_and_shards_give_the_same_numbers(
    planar: ffsms.SpaceManipulator, kept: dict[str, Path], tmp_path: Path
) -> None:
    whole = open_atlas(kept["joints"]).load()

    class Stop(Exception):
        pass

    def stop(done: int, of: int) -> None:
        if done >= 1000:
            raise Stop

    with pytest.raises(Stop):
        made(planar, tmp_path / "broken.zarr", progress=stop)
    assert not (tmp_path / "broken.zarr").exists()
    assert whole.identical(made(planar, tmp_path / "broken.zarr").load())

    out = tmp_path / "shards.zarr"
    for number in (2, 1):
        options = {"directions": DIRECTIONS, "seed": 3, "shard": Shard(number, 2)}
        assert atlas(planar, out, ROWS, **options) is None  # type: ignore[arg-type]
    assert whole.identical(made(planar, out).load())


def test_samples_that_are_gone_are_made_again(
    planar: ffsms.SpaceManipulator, kept: dict[str, Path], tmp_path: Path
) -> None:
    whole = open_atlas(kept["joints"]).load()
    out = tmp_path / "a.zarr"
    atlas(planar, out, ROWS, directions=DIRECTIONS, seed=3, shard=Shard(1, 2))
    shutil.rmtree(parts_folder(out) / "samples.zarr")
    assert whole.identical(made(planar, out).load())


def test_workers_give_the_same_numbers(
    planar: ffsms.SpaceManipulator, kept: dict[str, Path], tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    whole = open_atlas(kept["joints"]).load()
    atlas(planar, tmp_path / "two.zarr", ROWS, directions=DIRECTIONS, jobs=2, seed=3)
    assert whole.identical(open_atlas(tmp_path / "two.zarr").load())


def test_what_is_there_stays(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    out = tmp_path / "a.zarr"
    out.mkdir()
    with pytest.raises(ResultError, match="is there already"):
        made(planar, out)
    with pytest.raises(ResultError, match="cannot be read as an atlas"):
        open_atlas(tmp_path / "none.zarr")


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("sigma_1/.zarray", b'"chunks"', b'"chunkz"'),
        ("entropy/.zarray", b'"shuffle"', b'"shufle"'),
        ("z/.zarray", None, b""),
        ("base_rotation/.zarray", None, None),
        ("x/0", None, b""),
        ("x/0", None, None),
    ],
)
def test_a_damaged_file_is_told(
    kept: dict[str, Path], tmp_path: Path, file: str, old: bytes | None, new: bytes | None
) -> None:
    """Changed, empty or gone: without an error of zarr's, and without its warning."""
    shutil.copytree(kept["workspace"], tmp_path / "a.zarr")
    damaged = next(path for path in (tmp_path / "a.zarr").rglob("*") if str(path).endswith(file))
    content = damaged.read_bytes()
    damaged.unlink()
    if new is not None:
        damaged.write_bytes(new if old is None else content.replace(old, new))
        assert damaged.read_bytes() != content
    with pytest.raises(ResultError, match="cannot be read as an atlas"):
        open_atlas(tmp_path / "a.zarr")


@pytest.mark.parametrize("over", ["joints", "workspace"])
def test_a_block_that_is_damaged_is_told_by_the_figure(
    kept: dict[str, Path], tmp_path: Path, over: str
) -> None:
    shutil.copytree(kept[over], tmp_path / "a.zarr")
    block = next(path for path in (tmp_path / "a.zarr" / "entropy").iterdir() if path.name[0] == "0")
    block.write_bytes(block.read_bytes()[:40])
    with pytest.raises(ResultError, match="cannot be read from the atlas"):
        plot_atlas(open_atlas(tmp_path / "a.zarr"))


def test_a_folder_of_another_atlas_is_refused(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    out = tmp_path / "a.zarr"
    atlas(planar, out, ROWS, seed=1, shard=Shard(1, 2))
    with pytest.raises(ResultError, match="another specification"):
        atlas(planar, out, ROWS, seed=2, jobs=1)


def test_without_its_packages_it_says_what_to_install(
    planar: ffsms.SpaceManipulator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(DependencyMissing, match=r"pip install 'ffsms-pin\[cluster\]'"):
        made(planar, tmp_path / "a.zarr")
    assert not list(tmp_path.iterdir())


def test_wrong_arguments_are_named(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    for wrong in ({"over": "base"}, {"directions": [(0, 0, 0)]}, {"cells": 0}, {"method": "random"}):
        with pytest.raises(InvalidValue, match=next(iter(wrong))):
            atlas(planar, tmp_path / "a.zarr", ROWS, **wrong)


def test_cells_hold_every_point_once(rng: np.random.Generator) -> None:
    points = rng.uniform(-1.0, 2.0, (500, 3)) * [1.0, 0.3, 0.0]
    cells = Cells.around(points.min(axis=0), points.max(axis=0), 7)
    assert cells.shape == (7, 3, 1)
    index = cells.index(points)
    centres = np.stack(np.meshgrid(*cells.centres().values(), indexing="ij"), axis=-1).reshape(-1, 3)
    assert (np.abs(points - centres[index]) <= 0.5 * cells.edge + 1e-12).all()


def test_measures_do_not_depend_on_the_rows_beside(rng: np.random.Generator) -> None:
    sms = ffsms.load("satellite_ur5")
    joints = rng.uniform(-2.0, 2.0, (300, 6))
    whole, part = measured(sms, joints), measured(sms, joints[100:130])
    for name, values in part.items():
        np.testing.assert_allclose(values, whole[name][100:130], rtol=1e-5, atol=1e-7)


def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["atlas", "planar_3r", "--samples", "800", "--jobs", "1", "--direction", "1", "0", "0"]
    assert main([*arguments, "--over", "workspace", "--figures", "figures"]) == 0
    assert "atlas: planar_3r-workspace.zarr" in capsys.readouterr().out
    assert (tmp_path / "figures" / "atlas.png").stat().st_size > 10_000
    assert open_atlas(tmp_path / "planar_3r-workspace.zarr").attrs["command"].startswith("ffsms-pin")
    assert main([*arguments, "--over", "workspace"]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main([*arguments, "--shard", "1/2"]) == 0
    assert main([*arguments, "--shard", "3/2"]) == 2
