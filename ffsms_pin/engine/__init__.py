"""Many rows of work in chunks: in this process, over Dask's workers, or as one of several shards.

The result is a folder of chunk files. It depends on the work alone: not on the number of workers or shards,
nor on the order, nor on how often the run was killed and begun again. See `run`. `collected` gives
all rows as one table. `outcomes` is for tasks that give objects, one by one and in order.
"""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.engine.chunks import (
        ChunkFolder as ChunkFolder,
        Chunks as Chunks,
        Shard as Shard,
        Table as Table,
        joined as joined,
        parts_folder as parts_folder,
    )
    from ffsms_pin.engine.runs import collected as collected, run as run
    from ffsms_pin.engine.tasks import (
        Outcome as Outcome,
        all_results as all_results,
        end_kept as end_kept,
        outcomes as outcomes,
    )
else:
    __getattr__, __dir__, __all__ = later(__name__)
