"""A chunk whose workers died: the rows to blame are found by halving it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ffsms_pin.engine.chunks import halves
from ffsms_pin.engine.cluster import Cluster
from ffsms_pin.engine.spread import Killed, spread
from ffsms_pin.engine.task import Table, computed, joined, sent
from ffsms_pin.errors import TaskError

__all__ = ["KILLED", "Lost", "halved"]

KILLED = "killed its worker"

Lost = Callable[[int, str], Table]


def halved(cluster: Cluster, packed: bytes, rows: range, lost: Lost | None) -> dict[str, Any]:
    """The table of some rows that were given up because workers died.

    Each part is alone on the cluster, so no other task is to blame for a death.

    Parameters
    ----------
    cluster : Cluster
    packed : bytes
        The work, pickled.
    rows : range
    lost : callable, optional
        As for `run`.

    Raises
    ------
    TaskError
        One row kills its worker, and there is nothing to stand for it.
    """
    ((_, result),) = spread(cluster, [rows], lambda part: (sent, (computed, packed, part)))
    if not isinstance(result, Killed):
        return dict(result)
    if len(rows) > 1:
        return joined([halved(cluster, packed, part, lost) for part in halves(rows)])
    if lost is None:
        raise TaskError(f"row {rows.start} {KILLED} (out of memory, or a crash in compiled code)")
    table = lost(rows.start, KILLED)
    return computed(lambda _: table, rows)
