"""Many rows of work in chunks: in this process, over Dask's workers, or as one of several shards.

The result is a folder of chunk files. It depends on the work alone: not on the number of workers or shards,
nor on the order, nor on how often the run was killed and begun again. See `run`. `collected` gives the same
rows in memory. `outcomes` is for tasks that give objects, one by one and in order.
"""

from ffsms_pin.engine.chunks import Chunks, Shard
from ffsms_pin.engine.folder import ChunkFolder, parts_folder
from ffsms_pin.engine.kept import end_kept
from ffsms_pin.engine.outcomes import Outcome, all_results, outcomes
from ffsms_pin.engine.run import collected, run
from ffsms_pin.engine.task import Table, joined

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
