"""The definition of a campaign: a scenario file, distributions of its keys, and each seed's scenario."""

from __future__ import annotations

import hashlib
import json
import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ffsms_pin.campaigns.draws import drawn_content, flat_draws
from ffsms_pin.checks import whole
from ffsms_pin.errors import FfsmsWarning, ResultError
from ffsms_pin.files import LARGEST_DATA, read_content, read_json
from ffsms_pin.geometry.shapes import find_mesh
from ffsms_pin.scenarios import Scenario, scenario
from ffsms_pin.scenarios.definition import read, scenario_of
from ffsms_pin.version import __version__


@dataclass(frozen=True, eq=False)
class Campaign:
    """The runs of one scenario with the seeds `seed`, `seed` + 1, ..."""

    source: str  #: path of the scenario file
    content: Mapping[str, Any]  #: tables of the file without [campaign]; `compare` sets re-planning
    draws: Mapping[str, Any]  #: distributions by key, such as {"plant.arm_mass": {"uniform": [0.8, 1.2]}}
    runs: int  #: number of runs
    seed: int = 1  #: seed of the first run
    compare: bool = False  #: True to run each drawn scenario twice: planned once and re-planned
    allow_import: bool = False  #: the argument of `ffsms_pin.scenario`
    hash: str = ""  #: `digest` of the inputs of the stored results

    @classmethod
    def read(
        cls,
        name_or_path: str | os.PathLike[str],
        runs: int,
        seed: int | None = None,
        *,
        compare: bool = False,
        allow_import: bool = False,
    ) -> Campaign:
        """Read a campaign from a scenario file or packaged scenario; `seed` replaces the file's seed.

        A `path` in [guards] gives a warning, because campaigns write no recordings.
        """
        plain = scenario(name_or_path, allow_import=allow_import)
        content, source = read(plain.source), str(plain.source.absolute())
        first = whole("seed", plain.campaign.get("seed", 1) if seed is None else seed, 0)
        draws = dict(sorted(flat_draws(content.pop("campaign", {}).get("draw", {}))))
        if "path" in content.get("guards", {}):
            message = f"{plain.source}: a campaign writes no recordings, so [guards] path has no effect"
            warnings.warn(message, FfsmsWarning, stacklevel=2)
        if compare:
            content.setdefault("reference", {})["kind"] = "re-planning"
        campaign = cls(source, content, draws, whole("runs", runs, 1), first, compare, allow_import)
        campaign.scenario(first).load()  # reports wrong keys or a wrong robot before the first run
        return campaign

    @classmethod
    def open(cls, folder: str | os.PathLike[str], *, allow_import: bool = False) -> Campaign:
        """Read the campaign of a results folder."""
        file = Path(folder) / "campaign.json"
        if not file.exists():
            raise ResultError(folder, "is no results folder of a campaign (no campaign.json)")
        try:
            return cls(**{**read_json(file), "allow_import": allow_import})
        except TypeError:
            message = "is no results folder of a campaign of this version (campaign.json has other keys)"
            raise ResultError(folder, message) from None

    @property
    def seeds(self) -> range:
        """The seeds of the runs."""
        return range(self.seed, self.seed + self.runs)

    def scenario(self, seed: int) -> Scenario:
        """Return the scenario of a seed; raise `InvalidScenario` if a drawn key or value is invalid."""
        content = drawn_content(Path(self.source), self.content, self.draws, seed)
        return scenario_of(Path(self.source), content, allow_import=self.allow_import)

    def digest(self) -> str:
        """Return the SHA-256 of the inputs: tables, distributions, files in tables, and package versions.

        Modules beside the scenario file with a user's own terms and limits are included, but not the modules
        that they import. The meshes of robots are included.
        """
        robots = [self.content[table] for table in ("robot", "plant") if table in self.content]
        names = [robot.get("model") for robot in robots]
        names += [row.get("file") for row in self.content.get("obstacle", [])]
        names.append(self.content.get("path", {}).get("file"))
        rows = [*self.content.get("term", []), *self.content.get("limit", [])]
        names += [f"{row['use'].partition(':')[0].replace('.', '/')}.py" for row in rows if ":" in row["use"]]
        paths = [Path(self.source).parent / str(name) for name in names]
        for robot in robots:
            paths += _meshes(Path(self.source).parent, robot)
        parts: list[Any] = [read_content(path, LARGEST_DATA).hex() for path in paths if path.is_file()]
        parts += [__version__, *map(version, ("pin", "proxsuite", "daqp", "numpy", "scipy"))]
        parts += [self.content, self.draws, self.compare]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _meshes(folder: Path, robot: Mapping[str, Any]) -> list[Path]:
    """Return the mesh files that the robot file of a table names; `folder` has the scenario file."""
    path = folder / str(robot.get("model"))
    if not path.is_file():
        return []
    places = tuple(folder / name for name in robot.get("package_dirs", []))
    text = read_content(path).decode(errors="replace")
    names = dict.fromkeys(re.findall(r'\b(?:filename|file)\s*=\s*"([^"]+)"', text))
    folders = ["", *(f"{name}/" for name in re.findall(r'\bmeshdir\s*=\s*"([^"]+)"', text))]  # of MJCF
    meshes = [find_mesh(folder + name, path, places) for name in names for folder in folders]
    return [mesh for mesh in meshes if mesh is not None]
