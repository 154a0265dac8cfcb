"""`ffsms-pin merge`: table, report and figures of a campaign that was run in shards."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Make one table of a campaign's chunks (DIR/runs.parquet), a report (report.json) and figures.

example: ffsms-pin merge results/mine

exit codes: 0 done; 2 bad input, or runs are missing; 70 a defect of ffsms-pin; 130 interrupted;
143 terminated
"""


def add_parser(subparsers: Any) -> None:
    """Add `merge` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "merge",
        help="make the table of a campaign that was run in shards",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", metavar="DIR", help="the campaign's --out")
    parser.add_argument("--partial", action="store_true", help="take what is done where runs are missing")


def run(arguments: argparse.Namespace) -> int:
    """Make the table, and print the report; returns the exit code."""
    from ffsms_pin.cli.campaign_output import told
    from ffsms_pin.errors import ResultError

    folder = Path(arguments.folder)
    if not folder.is_dir():
        raise ResultError(folder, "is not the folder of a campaign; make one with `ffsms-pin campaign`")
    told(folder, arguments.partial)
    return 0
