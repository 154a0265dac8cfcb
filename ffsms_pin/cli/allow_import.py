"""The option `--allow-import` of every command that plans a scenario."""

from __future__ import annotations

import argparse

__all__ = ["add_allow_import"]


def add_allow_import(parser: argparse.ArgumentParser) -> None:
    """Let a scenario's terms and limits be Python classes of the user's own: off unless asked for."""
    parser.add_argument(
        "--allow-import",
        action="store_true",
        help="let the scenario import terms and limits from Python modules; this runs their code",
    )
