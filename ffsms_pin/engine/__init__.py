"""Many rows of work in chunks: in this process, over Dask's workers, or as one of several shards.

The result is a folder of chunk files. It depends on the work alone: not on the number of workers or shards,
nor on the order, nor on how often the run was killed and begun again. See `run`. `collected` gives the same
rows in memory. `outcomes` is for tasks that give objects, one by one and in order.
"""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.engine.folder import ChunkFolder, parts_folder
    from ffsms_pin.engine.kept import end_kept
    from ffsms_pin.engine.rows import Chunks, Shard, Table, joined
    from ffsms_pin.engine.runs import collected, run
    from ffsms_pin.engine.tasks import Outcome, all_results, outcomes

__all__ = [
    "ChunkFolder",
    "Chunks",
    "Outcome",
    "Shard",
    "Table",
    "all_results",
    "collected",
    "end_kept",
    "joined",
    "outcomes",
    "parts_folder",
    "run",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
