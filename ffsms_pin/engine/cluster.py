"""The cluster of a run: Dask's scheduler in this process with workers of our own, or one that stands.

And what Dask must not lose, Ctrl-C, and what its log must not say: lost connections are an error of ours.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from threading import current_thread, main_thread
from types import FrameType
from typing import Any

from ffsms_pin.checks import whole
from ffsms_pin.engine.worker import NOT_STARTED
from ffsms_pin.errors import ClusterError, InvalidValue
from ffsms_pin.extras import installed, require

_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")


@contextmanager
def put_off(wake: Callable[[], object] | None = None) -> Iterator[None]:
    """Call the handlers of SIGINT and SIGTERM at the end of the block, not within it.

    What a handler raises in a `__del__` or in the callback of a weak reference, as Dask has them, Python
    prints and drops: the program goes on as if nobody had pressed Ctrl-C. The second signal within a block
    does not wait. `wake` is called when a signal is put off, to end what the block waits for. Threads other
    than the main one get no signals.
    """
    if current_thread() is not main_thread():
        yield
        return
    handlers: dict[int, Callable[[int, FrameType | None], object]] = {}
    came: list[tuple[int, FrameType | None]] = []

    def note(number: int, frame: FrameType | None) -> None:
        if came:
            came.clear()
            handlers[number](number, frame)
            return
        came.append((number, frame))
        if wake is not None:
            wake()

    try:
        for one in (signal.SIGINT, signal.SIGTERM):
            handler = signal.getsignal(one)
            if callable(handler):
                handlers[one] = handler
                signal.signal(one, note)
        yield
    finally:
        for number, handler in handlers.items():
            if signal.getsignal(number) is note:  # nobody has set another one within the block
                signal.signal(number, handler)
        for number, frame in came:
            handlers[number](number, frame)


def _silenced() -> Callable[[], None]:
    logging.getLogger("distributed.batched").setLevel(logging.WARNING)  # a closed connection is told too late
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)

    def end() -> None:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)

    return end


class Shared:
    """`with` it something holds from the first of several uses at a time to the end of the last.

    If each use set back what it had found, one that ends would take it from another one that still goes on
    in another thread. `begin` makes it hold, and gives what sets back what it found.
    """

    def __init__(self, begin: Callable[[], Callable[[], None]]) -> None:
        self._begin, self._lock, self._uses = begin, threading.Lock(), 0
        self._end: Callable[[], None] = lambda: None

    def __enter__(self) -> None:
        with self._lock:
            if self._uses == 0:
                self._end = self._begin()
            self._uses += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._uses -= 1
            if self._uses == 0:
                self._end()


quiet = Shared(_silenced)  # the loggers are off


ALLOWED_FAILURES = 6  # deaths of workers that a task may have been assigned to; Dask's default is 3
MOST_JOBS = 1024
ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
}
# Dask works in a thread of the worker. glibc gives each thread memory of its own, which it hands back to the
# system and takes again at every large array: with one for all threads, stacks take a fifth less time.
ONE_ARENA = {"MALLOC_ARENA_MAX": "1"}
_FAILED_STARTS = 3  # in a row, before a run gives up
_CLOSING = 2.0  # [s]
_CONNECTING = 15.0  # [s]
_CONFIG = {
    "distributed.scheduler.http.routes": [],
    "distributed.comm.timeouts.connect": f"{_CONNECTING:g}s",
    "distributed.admin.tick.interval": "1s",  # at Dask's 20 ms a scheduler without work wakes this process
}
# Run by a worker's interpreter: it finds the modules that this process finds.
_BOOT = """\
import json, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
settings = json.loads(sys.argv[1])
sys.path[:] = settings["path"]
from ffsms_pin.engine.worker import serve
serve(*settings["worker"])
"""


def usable_cores() -> int:
    """Number of cores that this process may use; 1 where the packages for more are not installed."""
    if not installed("cluster"):
        return 1
    from dask.system import CPU_COUNT

    return int(CPU_COUNT)


def checked_jobs(jobs: int | None) -> int:
    """The number of workers that is asked for; by default one a core.

    `DependencyMissing`: several are asked for, and the packages for them are not installed.
    """
    if jobs is not None and whole("jobs", jobs, 1, MOST_JOBS) > 1:
        require("cluster", "working with several processes")
    return usable_cores() if jobs is None else int(jobs)


class Cluster:
    """A client of a scheduler at `address`, and `jobs` workers that are ours to keep alive.

    There are none of ours where the cluster stands already. They import `module` while they start.
    `end` kills them, since what they have not handed in is computed again, and closes `ending`.
    """

    def __init__(self, client: Any, address: str, ending: ExitStack, jobs: int = 0, module: str = "") -> None:
        self.client, self.address, self.jobs, self.module = client, address, jobs, module
        self._words = ending.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 - closed with it
        self._processes: dict[subprocess.Popen[bytes], str] = {}  # and the folders in which they start
        self.failed_starts = 0  # in a row: zero again as soon as a task has come to its end
        ending.callback(self._kill)
        self.end = ending.close

    def workers(self) -> int:
        """Number of workers that the scheduler knows."""
        try:
            return len(self.client.nthreads())
        except OSError as error:
            raise self.gone() from error

    def tend(self) -> None:
        """Start workers where they are missing; `ClusterError` where they cannot be started."""
        for process in [one for one in self._processes if one.poll() is not None]:
            self.failed_starts += process.returncode == NOT_STARTED
            shutil.rmtree(self._processes.pop(process), ignore_errors=True)
        if self.failed_starts >= _FAILED_STARTS:
            self._words.seek(0)
            said = self._words.read().decode(errors="replace").splitlines()
            last = next((line for line in reversed(said) if line.strip()), "they say nothing")
            raise ClusterError(f"the workers do not start: {last}")
        while len(self._processes) < self.jobs:
            self._start()

    def gone(self) -> ClusterError:
        """The error that says that the scheduler is lost."""
        return ClusterError(
            f"the scheduler at {self.address} is gone; what is written stays, "
            "and the same command goes on from there"
        )

    def _start(self) -> None:
        folder = tempfile.mkdtemp(prefix="ffsms-pin-worker-")
        settings = {"path": sys.path, "worker": (self.address, os.getpid(), folder, self.module)}
        try:
            process = subprocess.Popen(
                [sys.executable, "-c", _BOOT, json.dumps(settings)],
                stdin=subprocess.DEVNULL,
                stdout=self._words,
                stderr=self._words,
                env={**os.environ, **ONE_THREAD, **ONE_ARENA},
            )
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise ClusterError(f"no worker can be started ({error.strerror}); ask for fewer jobs") from None
        self._processes[process] = folder

    def _kill(self) -> None:
        for process in self._processes:
            process.kill()
        for process, folder in self._processes.items():
            process.wait()
            shutil.rmtree(folder, ignore_errors=True)  # one that was killed while it started leaves it


@contextmanager
def embedded(jobs: int, allowed_failures: int = ALLOWED_FAILURES, module: str = "") -> Iterator[Cluster]:
    """A cluster of this machine for one run; parameters and errors as of `started`."""
    with quiet:
        cluster = started(jobs, allowed_failures, module)
        try:
            yield cluster
        finally:
            cluster.end()


def started(jobs: int, allowed_failures: int, module: str = "") -> Cluster:
    """A cluster of this machine: the scheduler in this process, workers with one thread each, on loopback.

    Whoever starts it ends it, by its `end`. Dask gives up a task when more than `allowed_failures` workers
    died to which it was assigned.
    """
    dask, distributed = packages()
    with ExitStack() as ending:
        # A scheduler puts nothing into its folder, which goes as soon as it stands.
        with (
            tempfile.TemporaryDirectory(prefix="ffsms-pin-scheduler-", ignore_cleanup_errors=True) as scratch,
            put_off(),
            dask.config.set({**_CONFIG, "temporary-directory": scratch}),
        ):
            local = distributed.LocalCluster(
                n_workers=0,
                processes=True,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                scheduler_kwargs={"dashboard": False, "allowed_failures": allowed_failures},
                silence_logs=logging.CRITICAL,
            )
            ending.enter_context(local)
            client = ending.enter_context(distributed.Client(local, set_as_default=False))
        cluster = Cluster(client, local.scheduler_address, ending, jobs, module)
        cluster.tend()
        cluster.end = ending.pop_all().close
    return cluster


@contextmanager
def connected(address: str) -> Iterator[Cluster]:
    """A cluster that stands already, at its scheduler's address; `ClusterError` where nothing answers."""
    if not isinstance(address, str) or "://" not in address:
        raise InvalidValue("scheduler", address, "must be an address as tcp://host:8786")
    dask, distributed = packages()
    with quiet, dask.config.set({"distributed.comm.timeouts.connect": f"{_CONNECTING:g}s"}):
        try:
            with put_off():
                client = distributed.Client(address, timeout=_CONNECTING, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ClusterError(
                f"no scheduler answers at {address}; start one with: dask scheduler"
            ) from error
        with ExitStack() as ending:
            try:
                yield Cluster(client, address, ending)
            finally:
                with suppress(Exception):  # a scheduler that is gone cannot be told
                    client.close(timeout=_CLOSING)


def packages() -> tuple[Any, Any]:
    """Dask and distributed; `DependencyMissing` where they are not installed."""
    require("cluster", "working with several processes")
    import dask
    import distributed

    return dask, distributed
