"""Many rows of work in chunks: in this process, over Dask's workers, or as one of several shards.

The result is a folder of chunk files. It depends on the work alone: not on the number of workers or shards,
nor on the order, nor on how often the run was killed and begun again. See `run`. `collected` gives
all rows as one table. `outcomes` is for tasks that give objects, one by one and in order.
"""

from ffsms_pin.engine.chunks import ChunkFolder, Chunks, Shard, Table, joined, parts_folder
from ffsms_pin.engine.runs import collected, run
from ffsms_pin.engine.tasks import Outcome, all_results, end_kept, outcomes

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
