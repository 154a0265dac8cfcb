"""Arguments of `simulate` from one mapping, for tests that are parametrised over them."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from ffsms_pin.simulation import Conditions

__all__ = ["under"]

_CONDITIONS = [field.name for field in fields(Conditions)]


def under(**options: Any) -> dict[str, Any]:
    """Return keyword arguments of `simulate`; fields of `Conditions` are put into one."""
    conditions = {name: options.pop(name) for name in _CONDITIONS if name in options}
    return {**options, "conditions": Conditions(**conditions)}
