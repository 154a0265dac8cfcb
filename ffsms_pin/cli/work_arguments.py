"""Arguments of commands whose work is done in chunks: processes, a Dask scheduler, shards."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["add_work_arguments", "work_arguments"]


def add_work_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --jobs, --scheduler and --shard."""
    parser.add_argument("--jobs", type=int, metavar="N", help="processes at once (default: one a core)")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="a Dask scheduler that stands, as tcp://host:8786"
    )
    parser.add_argument(
        "--shard", metavar="I/N", help="do every N-th chunk only; the command without it does the rest"
    )


def work_arguments(arguments: argparse.Namespace) -> dict[str, Any]:
    """They as keyword arguments of `ffsms_pin.engine.run`."""
    from ffsms_pin.engine import Shard

    shard = None if arguments.shard is None else Shard.read(arguments.shard)
    return {"jobs": arguments.jobs, "scheduler": arguments.scheduler, "shard": shard}
