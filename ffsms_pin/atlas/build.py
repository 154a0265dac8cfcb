"""`atlas`: sample a robot's configurations into a Zarr file, and `open_atlas`, which reads one."""

from __future__ import annotations

import hashlib
import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from ffsms_pin.atlas.dataset import Blocks, write_workspace
from ffsms_pin.atlas.measures import BLOCK, Sampling
from ffsms_pin.checks import direction, instance, one_of, optional_callable, whole
from ffsms_pin.engine import ChunkFolder, Chunks, Shard, parts_folder, run
from ffsms_pin.errors import ResultError
from ffsms_pin.extras import require
from ffsms_pin.storage import check_readable, path_like, remove_leftovers, require_space, told
from ffsms_pin.storage.files import staged_folder
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.version import __version__

# Rows of a block: what is lost when a run is killed, and what a process holds in memory.
CHUNK = BLOCK
_SAMPLES = "samples.zarr"
CELLS = 48  # along the longest side of a workspace


def atlas(
    sms: SpaceManipulator,
    out: str | os.PathLike[str],
    samples: int,
    over: str = "joints",
    *,
    method: str = "sobol",
    seed: int = 0,
    directions: Sequence[ArrayLike] = (),
    cells: int = CELLS,
    jobs: int | None = None,
    scheduler: str | None = None,
    shard: Shard | None = None,
    progress: Callable[[int, int], None] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Path | None:
    """Measure a robot's coupling over its joint ranges, and write what was found to a Zarr file.

    The samples are computed in blocks of 65,536 rows. Every process writes its own blocks, into a folder
    beside `out`; a run that was killed goes on from there. When all are there, the file moves to `out` and
    the folder goes. See docs/atlas.md for what is measured, and for memory and time.

    Parameters
    ----------
    sms : SpaceManipulator
    out : path
        Must not be there yet.
    samples : int
        Of a grid, the largest number of them.
    over : {"joints", "workspace"}
        One row a sample, or statistics of the samples in each cell of the workspace.
    method : {"sobol", "grid"}
        See `Sampling`.
    seed : int
    directions : sequence of array_like, shape (3,)
        Base axes, for the coupling assistance.
    cells : int
        Along the longest side of the workspace.
    jobs, scheduler, shard, progress
        See `ffsms_pin.engine.run`. A shard computes its chunks only; a run without one, after all shards,
        writes the file.
    provenance : mapping, optional
        More attributes of the dataset: the command, for one.

    Returns
    -------
    Path or None
        Of the Zarr file; None for a shard.

    Raises
    ------
    DependencyMissing
        xarray, zarr and what else comes with ffsms-pin[cluster] is not installed.
    InvalidValue, ResultError, ClusterError
    """
    require("cluster", "an atlas")  # found out before the work
    instance("sms", sms, SpaceManipulator)
    one_of("over", over, ("joints", "workspace"))
    whole("cells", cells, 1)
    optional_callable("progress", progress)
    target = Path(os.path.realpath(path_like("out", out)))
    if target.exists():
        raise ResultError(out, "is there already; remove it, or choose another name")
    sampling = Sampling.of(sms, samples, method, seed)
    instance("provenance", provenance, Mapping, optional=True)
    instance("directions", directions, Iterable)
    parts = ChunkFolder(parts_folder(target))
    units = tuple(tuple(direction(f"directions[{i}]", one).tolist()) for i, one in enumerate(directions))
    blocks = Blocks(parts.path / _SAMPLES, Chunks(sampling.rows, CHUNK), sms, sampling, units)
    numbers = 7 + sms.n + min(6, sms.n) + len(blocks.directions)
    require_space(target, 4 * numbers * sampling.rows)
    specification = _specification(blocks)
    tasks = Chunks(len(blocks.rows), 1)
    parts.open(tasks, specification)
    if not blocks.path.exists():
        for index in parts.done():  # of a file that is gone
            parts.file(index).unlink(missing_ok=True)
    run(
        blocks,
        tasks,
        parts.path,
        specification=specification,
        jobs=jobs,
        scheduler=scheduler,
        shard=shard,
        prepare=blocks.make,
        progress=progress and (lambda done, of: progress(min(done * CHUNK, sampling.rows), sampling.rows)),
    )
    if shard is not None:
        return None
    _write(target, blocks, over, cells, {**_attributes(blocks, over), **(provenance or {})})
    shutil.rmtree(parts.path, ignore_errors=True)
    return target


def open_atlas(path: str | os.PathLike[str]) -> Any:
    """An atlas as an xarray.Dataset, which reads what is asked for when it is asked for.

    `ResultError` says that it is missing or cannot be read. Blocks of values are read later: of one that is
    damaged figures say so, zarr raises a RuntimeError, and one that is missing is NaN.
    """
    require("cluster", "an atlas")
    import xarray as xr

    place = path_like("path", path)
    try:
        for described in (*place.glob(".z*"), *place.glob("*/.z*")):
            check_readable(described)
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # zarr leaves out what it cannot read, and warns
            data = xr.open_zarr(place, consolidated=False)
        lost = [name for name, one in data.coords.items() if one.dtype.kind == "f" and one.isnull().any()]
        if lost:
            raise ValueError(f"coordinates are missing: {', '.join(map(str, lost))}")
    except Exception as error:  # of zarr, its codecs and xarray: each has its own kinds
        raise ResultError(place, f"cannot be read as an atlas ({error})") from None
    return data


def _write(target: Path, blocks: Blocks, over: str, cells: int, attributes: Mapping[str, Any]) -> None:
    """The dataset, whole or not at all."""
    with told(target):
        if over == "joints":
            blocks.describe(attributes)
            blocks.path.rename(target)
            return
        remove_leftovers(target.parent)
        with staged_folder(target.parent, target.name) as staging:
            write_workspace(staging / "atlas", blocks.tables, cells, attributes)
            (staging / "atlas").rename(target)


def _specification(work: Blocks) -> dict[str, Any]:
    """All that the chunks depend on; what they are made into later is not part of it."""
    return {
        "what": "atlas",
        "block_rows": CHUNK,
        "model": work.sms.model.name,
        "robot_sha256": digest(work.sms),
        "end_effector": work.sms.end_effector,
        "sampling": asdict(work.sampling),
        "directions": [list(row) for row in work.directions],
        "version": __version__,
    }


def _attributes(work: Blocks, over: str) -> dict[str, Any]:
    sampling = work.sampling
    return {
        "title": f"Dynamic coupling of {work.sms.model.name} over its {over}",
        "source": f"ffsms-pin {__version__}",
        "model": work.sms.model.name,
        "robot_sha256": digest(work.sms),
        "end_effector_frame": work.sms.end_effector,
        "conventions": "base axes; reference point: the base's centre of mass; zero momentum",
        "over": over,
        "sampling": sampling.method,
        "samples": sampling.rows,
        "seed": sampling.seed,
        "lower_limits_rad": list(sampling.lower),
        "upper_limits_rad": list(sampling.upper),
        "joint_names": work.sms.joint_names,
        "directions": [x for row in work.directions for x in row],
    }


def digest(sms: SpaceManipulator) -> str:
    """Of all that the samples depend on: the tree, its inertias and the end effector's place."""
    model, frame = sms.model, sms.model.frames[sms.frame_id]
    digest = hashlib.sha256()
    for j in range(1, model.njoints):
        digest.update(f"{model.parents[j]} {model.joints[j].shortname()}".encode())
        digest.update(model.jointPlacements[j].homogeneous.tobytes())
        digest.update(model.inertias[j].matrix().tobytes())
    digest.update(f"{frame.parentJoint}".encode() + frame.placement.homogeneous.tobytes())
    return digest.hexdigest()
