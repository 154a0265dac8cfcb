"""`ffsms-pin campaign`: one scenario many times, with what its file draws."""

from __future__ import annotations

import argparse

from rich.console import Console

import ffsms_pin.campaigns as campaigns
from ffsms_pin.cli.arguments import work_arguments
from ffsms_pin.cli.merge import merged
from ffsms_pin.cli.output import say
from ffsms_pin.cli.progress import counted_progress
from ffsms_pin.cli.results_folder import chosen_folder

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Run the campaign, and where it is complete, make table, report and figures."""
    work = work_arguments(arguments)
    chosen = campaigns.Campaign.read(
        arguments.scenario, arguments.runs, arguments.seed, allow_import=arguments.allow_import
    )
    folder = chosen_folder(arguments.out, f"{chosen.source.stem}-campaign")
    with counted_progress(Console(stderr=True), "runs") as progress:
        place = campaigns.campaign(chosen, folder, progress=progress, **work)
    if arguments.shard is None:
        merged(folder)
    else:
        missing = len(place.missing())
        words = f"{missing} chunks are missing still" if missing else "all shards are done"
        say(f"shard {arguments.shard} is done; {words}; the table: ffsms-pin merge {folder}")
    return 0
