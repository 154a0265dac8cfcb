"""`ffsms-pin scenario`: packaged scenario files as text, and the JSON Schema of all of them."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Print a packaged scenario file, to be changed and run, or the JSON Schema of scenario files, with which
editors complete keys and show units.

examples:
  ffsms-pin scenario --print case-2 > mine.toml
  ffsms-pin scenario --schema > scenario.schema.json

An editor that reads schemas of TOML (Even Better TOML, Taplo) takes it by a first line in the file:
  #:schema ./scenario.schema.json
"""


def add_parser(subparsers: Any) -> None:
    """Add `scenario` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "scenario",
        help="a packaged scenario file as text, or the JSON Schema of scenario files",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--print", dest="name", metavar="NAME", help="case-1, case-2, wrong-model, capture")
    what.add_argument("--schema", action="store_true", help="the JSON Schema")


def run(arguments: argparse.Namespace) -> int:
    """Print what was asked for; returns the exit code."""
    from ffsms_pin.errors import InvalidValue, meant
    from ffsms_pin.scenarios.file import schema
    from ffsms_pin.scenarios.reading import packaged_path, scenario_names

    if arguments.schema:
        sys.stdout.write(json.dumps(schema(), indent=2, ensure_ascii=False) + "\n")
        return 0
    if arguments.name not in (names := scenario_names()):
        guess = meant(arguments.name, names)
        must = f"must be one of {', '.join(names)}" + (f"; {guess}" if guess else "")
        raise InvalidValue("--print", arguments.name, must)
    sys.stdout.write(packaged_path(arguments.name).read_text(encoding="utf-8"))
    return 0
