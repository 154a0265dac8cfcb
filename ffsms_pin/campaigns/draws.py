"""Distributions that a scenario file gives for its own keys, and what a seed draws from them."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import LARGEST

KINDS = ("uniform", "normal", "choice")


class DrawError(Exception):
    """A distribution cannot be used; the text says why."""


@dataclass(frozen=True)
class Draw:
    """The distribution of one key.

    Attributes
    ----------
    key : str
        Path of the key in the scenario file, as plant.arm_mass, or fault.1.time in the first [[fault]].
    kind : str
        "uniform" (low, high), "normal" (mean, standard deviation) or "choice" (values, each as likely).
    values : tuple
        Two numbers, or two lists of numbers of one length; or the choices.
    """

    key: str
    kind: str
    values: tuple[Any, ...]

    def value(self, seed: int) -> Any:
        """What a run's seed draws: a number, a list of numbers, or one of the choices.

        Every key has a stream of its own, so that another draw in the file changes nothing here.
        """
        rng = np.random.default_rng([seed, zlib.crc32(self.key.encode())])
        if self.kind == "choice":
            return self.values[int(rng.integers(len(self.values)))]
        first, second = (np.asarray(value, dtype=np.float64) for value in self.values)
        found = rng.uniform(first, second) if self.kind == "uniform" else rng.normal(first, second)
        return found.tolist() if np.ndim(found) else float(found)


def read_draws(table: Mapping[str, Any]) -> tuple[Draw, ...]:
    """The draws of a [campaign.draw] table, by key in alphabetical order.

    Raises
    ------
    DrawError
        A key has no distribution, or one that cannot be used.
    """
    return tuple(sorted((_draw(key, spec) for key, spec in _leaves("", table)), key=lambda draw: draw.key))


def _leaves(path: str, table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Keys as paths: `plant.arm_mass` in TOML is a table in a table, `"plant.arm_mass"` is one key."""
    for name, value in table.items():
        key = f"{path}.{name}" if path else name
        if isinstance(value, Mapping) and not set(value) & set(KINDS):
            if not value:
                raise DrawError(f"{key} has no distribution: give one of {', '.join(KINDS)}")
            yield from _leaves(key, value)
        else:
            yield key, value


def _draw(key: str, spec: Any) -> Draw:
    if not isinstance(spec, Mapping) or len(spec) != 1:
        raise DrawError(
            f"{key} must have one distribution, as {{ uniform = [0.9, 1.1] }}; one of {', '.join(KINDS)}"
        )
    ((kind, values),) = spec.items()
    if kind not in KINDS:
        raise DrawError(f"{key} has no distribution that is known: '{kind}'; give one of {', '.join(KINDS)}")
    if not isinstance(values, list) or not values:
        raise DrawError(f"{key} {kind} must be a list that is not empty")
    if kind == "choice":
        return Draw(key, kind, tuple(values))
    numbers = [_numbers(value) for value in values]
    if len(numbers) != 2 or any(one is None for one in numbers) or np.shape(values[0]) != np.shape(values[1]):
        what = "low and high" if kind == "uniform" else "mean and standard deviation"
        raise DrawError(f"{key} {kind} must hold two numbers, or two lists of numbers of one length: {what}")
    first, second = (np.asarray(value) for value in values)
    if kind == "uniform" and (first > second).any():
        raise DrawError(f"{key} uniform has a low end above its high end")
    if kind == "normal" and (second < 0.0).any():
        raise DrawError(f"{key} normal has a standard deviation below zero")
    return Draw(key, kind, tuple(values))


def _numbers(value: Any) -> Any:
    """The value where it is a number or a list of numbers; None where it is not."""
    entries = value if isinstance(value, list) else [value]
    usable = entries and all(
        isinstance(entry, (int, float)) and not isinstance(entry, bool) and abs(entry) <= LARGEST
        for entry in entries
    )
    return value if usable else None
