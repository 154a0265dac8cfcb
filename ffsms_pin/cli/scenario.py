"""The command `ffsms-pin scenario`: a packaged scenario file, or the JSON Schema of scenario files."""

from __future__ import annotations

import argparse
import json
import sys

from ffsms_pin.errors import InvalidValue, meant
from ffsms_pin.scenarios.definition import packaged_path, scenario_names, schema


def run(arguments: argparse.Namespace) -> int:
    """Print the file or the schema."""
    if arguments.schema:
        sys.stdout.write(json.dumps(schema(), indent=2, ensure_ascii=False) + "\n")
        return 0
    name, names = arguments.name, scenario_names()
    if name not in names:
        raise InvalidValue("--print", name, f"must be one of {', '.join(names)}{meant(name, names, '; ')}")
    sys.stdout.write(packaged_path(name).read_text(encoding="utf-8"))
    return 0
