"""`ffsms-pin scenario`: packaged scenario files as text, and the JSON Schema of all of them."""

from __future__ import annotations

import argparse
import json
import sys

from ffsms_pin.errors import InvalidValue, meant
from ffsms_pin.scenarios.file import packaged_path, scenario_names, schema

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Print what was asked for."""
    if arguments.schema:
        sys.stdout.write(json.dumps(schema(), indent=2, ensure_ascii=False) + "\n")
        return 0
    if arguments.name not in (names := scenario_names()):
        guess = meant(arguments.name, names, "; ")
        raise InvalidValue("--print", arguments.name, f"must be one of {', '.join(names)}{guess}")
    sys.stdout.write(packaged_path(arguments.name).read_text(encoding="utf-8"))
    return 0
