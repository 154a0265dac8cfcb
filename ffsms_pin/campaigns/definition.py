"""A campaign: a scenario file, the distributions of what is drawn of it, and the scenario of a seed."""

from __future__ import annotations

import copy
import hashlib
import os
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.checks import LARGEST, whole
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.files import LARGEST_DATA, read_content
from ffsms_pin.scenarios import Scenario, scenario
from ffsms_pin.scenarios.definition import scenario_of
from ffsms_pin.scenarios.file import read
from ffsms_pin.scenarios.keys import DEGREES
from ffsms_pin.version import __version__

# And what two numbers of each mean.
KINDS = {"uniform": "low and high", "normal": "mean and standard deviation", "choice": ""}


class DrawError(Exception):
    """A distribution cannot be used; the text says why."""


@dataclass(frozen=True, eq=False)
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
        """What a run's seed draws: a number, a list of numbers, or one of the choices."""
        rng = _stream(self.key, seed)
        if self.kind == "choice":
            return self.values[int(rng.integers(len(self.values)))]
        first, second = (np.asarray(value, dtype=np.float64) for value in self.values)
        found = rng.uniform(first, second) if self.kind == "uniform" else rng.normal(first, second)
        return found.tolist() if np.ndim(found) else float(found)


def _stream(key: str, seed: int) -> np.random.Generator:
    """Every key has a stream of its own, so that another draw in the file changes nothing for it."""
    return np.random.default_rng([seed, zlib.crc32(key.encode())])


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
    if len(values) != 2 or not all(map(_numeric, values)) or np.shape(values[0]) != np.shape(values[1]):
        what = f"two numbers, or two lists of numbers of one length: {KINDS[kind]}"
        raise DrawError(f"{key} {kind} must hold {what}")
    first, second = (np.asarray(value) for value in values)
    if kind == "uniform" and (first > second).any():
        raise DrawError(f"{key} uniform has a low end above its high end")
    if kind == "normal" and (second < 0.0).any():
        raise DrawError(f"{key} normal has a standard deviation below zero")
    return Draw(key, kind, tuple(values))


def _numeric(value: Any) -> bool:
    """Whether a value is a number or a list of numbers."""
    entries = value if isinstance(value, list) else [value]
    return bool(entries) and all(
        isinstance(entry, (int, float)) and not isinstance(entry, bool) and abs(entry) <= LARGEST
        for entry in entries
    )


# Tables with a seed of their own: every run gets its own, unless the file draws it.
_SEEDS = ("sensors.seed", "wrist.seed", "plant.random.seed", "client.sensor.seed")
_PACKAGES = ("pin", "proxsuite", "numpy", "scipy")


@dataclass(frozen=True, eq=False)
class Campaign:
    """Runs of one scenario, whose seeds are `seed`, `seed` + 1, ...

    Attributes
    ----------
    source : Path
        The scenario file.
    content : mapping
        What it holds, without [campaign].
    draws : tuple of Draw
    runs : int
    seed : int
        Of the first run.
    allow_import : bool
        As for `ffsms_pin.scenario`.
    """

    source: Path
    content: Mapping[str, Any]
    draws: tuple[Draw, ...]
    runs: int
    seed: int = 1
    allow_import: bool = False

    @classmethod
    def read(
        cls,
        name_or_path: str | os.PathLike[str],
        runs: int,
        seed: int | None = None,
        *,
        allow_import: bool = False,
    ) -> Campaign:
        """A campaign from a scenario file; `seed` stands in for the file's.

        Raises
        ------
        InvalidScenario
            The file or one of its draws cannot be used.
        InvalidValue
            No runs, or a seed below zero.
        """
        whole("runs", runs, 1)
        plain = scenario(name_or_path, allow_import=allow_import)
        seed = whole("seed", plain.campaign.get("seed", 1) if seed is None else seed, 0)
        content = read(plain.source)
        table = content.pop("campaign", {})
        try:
            draws = read_draws(table.get("draw", {}))
        except DrawError as problem:
            raise InvalidScenario(plain.source, f"[campaign.draw] {problem}") from None
        found = cls(plain.source.absolute(), content, draws, runs, seed, allow_import)
        found.scenario(seed).load()  # a key or a robot that is not there is found out before anything is run
        return found

    @classmethod
    def from_specification(
        cls, specification: Mapping[str, Any], where: Mapping[str, str], allow_import: bool = False
    ) -> Campaign:
        """The campaign whose `specification` this is, its file being `where`."""
        draws = tuple(Draw(key, kind, tuple(values)) for key, kind, values in specification["draws"])
        source, content = Path(where["source"]), specification["scenario"]
        return cls(source, content, draws, specification["runs"], specification["seed"], allow_import)

    def specification(self) -> dict[str, Any]:
        """Everything that the table depends on, as JSON can hold it."""
        return {
            "runs": self.runs,
            "seed": self.seed,
            "scenario": dict(self.content),
            "draws": [[draw.key, draw.kind, list(draw.values)] for draw in self.draws],
            "models": self._model_hashes(),
            "versions": {"ffsms_pin": __version__, **{name: version(name) for name in _PACKAGES}},
        }

    @property
    def where(self) -> dict[str, str]:
        """The scenario file: its content counts, its place does not."""
        return {"source": str(self.source)}

    def drawn(self, seed: int) -> dict[str, Any]:
        """What a seed draws, by key."""
        return {draw.key: draw.value(whole("seed", seed, 0)) for draw in self.draws}

    def scenario(self, seed: int) -> Scenario:
        """The scenario of one run.

        Raises
        ------
        InvalidScenario
            A draw has a key that the scenario does not have, or a value that it cannot use.
        """
        whole("seed", seed, 0)
        content = copy.deepcopy(dict(self.content))
        for key, value in {**self._own_seeds(seed), **self.drawn(seed)}.items():
            if not _set(content, key.split("."), value):
                raise InvalidScenario(
                    self.source,
                    f"[campaign.draw] {key} is no key of the file: write it as plant.arm_mass, "
                    "or as fault.1.time for the first [[fault]]",
                )
        for name in ("fault", "capture", "disturbance"):  # {} among the choices: without it
            if isinstance(content.get(name), list):
                content[name] = [row for row in content[name] if row != {}]
        return scenario_of(self.source, content, allow_import=self.allow_import)

    def _own_seeds(self, seed: int) -> dict[str, int]:
        """Seeds of noise and of random plants, where the scenario has them."""
        chosen = {}
        for key in _SEEDS:
            table: Any = self.content
            for name in key.split(".")[:-1]:
                table = table.get(name) if isinstance(table, Mapping) else None
            if table is not None:
                chosen[key] = int(_stream(key, seed).integers(2**31))
        return chosen

    def _model_hashes(self) -> dict[str, str]:
        """SHA-256 of robots and obstacles that are files, by their name in the scenario."""
        found = {}
        named = [self.content.get(table, {}).get("model") for table in ("robot", "plant")]
        named += [row.get("file") for row in self.content.get("obstacle", [])]
        for name in named:
            path = self.source.parent / str(name)
            if name is not None and path.is_file():
                found[str(name)] = hashlib.sha256(read_content(path, LARGEST_DATA)).hexdigest()
        return found


def _set(content: Any, path: list[str], value: Any) -> bool:
    """Set a key of nested tables and lists of tables, counted from 1; False where there is no such place."""
    name, *rest = path
    key: Any = name
    if isinstance(content, list):
        key = int(name) - 1 if name.isdecimal() else -1
        if key not in range(len(content)):
            return False
    elif not isinstance(content, dict) or not name:
        return False
    if rest:
        return _set(content[key] if isinstance(content, list) else content.setdefault(key, {}), rest, value)
    if isinstance(content, dict):  # the drawn value stands in for the file's, whatever the unit of each
        content.pop(name.removesuffix(DEGREES) if name.endswith(DEGREES) else name + DEGREES, None)
    content[key] = copy.deepcopy(value)
    return True
