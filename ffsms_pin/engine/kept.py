"""`kept`: an embedded cluster whose workers wait a minute for the next call, which need not start them."""

from __future__ import annotations

import atexit
import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock, Timer

from ffsms_pin.engine.cluster import Cluster, started
from ffsms_pin.engine.interrupts import quiet

__all__ = ["end_kept", "kept"]

IDLE = 60.0  # [s]
# A death is held against the few tasks of that worker at once: each is tried again alone.
_ALLOWED_FAILURES = 0


class _Clusters:
    """The clusters of this process: one that waits, and those that are in use."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.open: set[Cluster] = set()
        self.waiting: Cluster | None = None
        self.timer: Timer | None = None
        self.registered = False  # what ends them with the process


_clusters = _Clusters()


@contextmanager
def kept(jobs: int) -> Iterator[Cluster]:
    """A cluster of `jobs` workers for one use; two uses at a time have two.

    It waits for a minute then, in case that the next use wants as many workers. It ends with the process, and
    after a use that ended with an error, Ctrl-C among them.
    """
    cluster = _taken(jobs)
    if cluster is None:
        with quiet():
            cluster = started(jobs, _ALLOWED_FAILURES)
        # Once the first cluster is there: what Dask does at the end of a process comes after this then.
        if not _clusters.registered:
            atexit.register(_end_all)
            _clusters.registered = True
        _clusters.open.add(cluster)
    try:
        with quiet():
            cluster.tend()
            yield cluster
    except GeneratorExit:  # whoever asked for the results wants no more of them
        _put_back(cluster)
        raise
    except BaseException:
        _end(cluster)
        raise
    _put_back(cluster)


def end_kept() -> None:
    """End the cluster that waits, if there is one."""
    if (cluster := _taken()) is not None:
        _end(cluster)


def _taken(jobs: int = 0) -> Cluster | None:
    """The cluster that waits; one with another number of workers than the wanted one is ended."""
    with _clusters.lock:
        cluster, _clusters.waiting = _clusters.waiting, None
        if _clusters.timer is not None:
            _clusters.timer.cancel()
    if cluster is None or jobs in (0, cluster.jobs):
        return cluster
    _end(cluster)
    return None


def _put_back(cluster: Cluster) -> None:
    """Let a cluster wait; one that waits already is enough."""
    if cluster not in _clusters.open:  # the process ends, and its clusters have ended already
        return
    with _clusters.lock:
        if waits := _clusters.waiting is None:
            _clusters.waiting = cluster
            _clusters.timer = Timer(IDLE, _end_idle, (cluster,))
            _clusters.timer.daemon = True
            _clusters.timer.start()
    if not waits:
        _end(cluster)


def _end_idle(cluster: Cluster) -> None:
    with _clusters.lock:
        if _clusters.waiting is not cluster:
            return
        _clusters.waiting = None
    _end(cluster)


def _end(cluster: Cluster) -> None:
    _clusters.open.discard(cluster)
    with quiet():
        cluster.end()


def _end_all() -> None:
    while _clusters.open:
        _end(next(iter(_clusters.open)))


def _forget() -> None:
    """In a process that was forked: the clusters are its parent's."""
    global _clusters
    _clusters = _Clusters()


os.register_at_fork(after_in_child=_forget)
