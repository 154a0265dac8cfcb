"""A worker process of the embedded cluster: one thread, loopback only, gone when its parent is."""

from __future__ import annotations

import importlib
import os
import shutil
import threading
import time
import traceback
from contextlib import suppress

NOT_STARTED = 71  # exit status of a worker that could not begin

_CONFIG = {
    "distributed.worker.profile.enabled": False,
    "distributed.worker.use-file-locking": False,
    "distributed.admin.tick.limit": "1h",  # long steps in compiled code are what a worker is for
    # At Dask's 20 ms the second thread takes a tenth of the work's time.
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}


def serve(address: str, parent: int, folder: str, module: str = "") -> None:
    """Work for the scheduler at an address until it closes, or the process `parent` is gone.

    `folder` is removed as soon as the worker has begun. `module`, where it is not empty, is imported before
    the worker asks for tasks, since they will need it.
    """
    threading.Thread(target=_watch, args=(parent, folder), name="end-with-parent", daemon=True).start()
    if module:
        with suppress(Exception):  # the task itself says what is wrong with it
            importlib.import_module(module)
    import asyncio  # the parent, which only takes the status from here, does without

    asyncio.run(_serve(address, folder))


async def _serve(address: str, folder: str) -> None:
    try:
        import dask
        from distributed import Worker

        dask.config.set(_CONFIG)
        worker = await Worker(
            address,
            nthreads=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            dashboard=False,
            local_directory=folder,
            memory_limit=0,
        )
    except BaseException:  # the parent reads the last line and the status, and removes the folder
        traceback.print_exc()
        os._exit(NOT_STARTED)
    # Workers without a memory limit put nothing on disk: what is removed now cannot be left over.
    _remove(folder)
    await worker.finished()


def _remove(folder: str) -> None:
    """Remove the folder, also where a worker that starts, or its other thread, has hands in it meanwhile."""
    for _ in range(20):
        shutil.rmtree(folder, ignore_errors=True)
        if not os.path.exists(folder):
            break


def _watch(parent: int, folder: str) -> None:
    """End this process soon after its parent has ended, however that came about, and remove the folder.

    A process whose parent was killed is not told: a thread looks every second whose child this process is.
    It ends at once then, without the clean-up that might wait for the parent.
    """
    while os.getppid() == parent:
        time.sleep(1.0)
    try:
        _remove(folder)
    finally:
        os._exit(1)  # nobody is left to read it
