"""Errors of the library: one root class, subclasses that name what failed and carry the values.

`require` raises `DependencyMissing` if a package of an extra is not installed.
"""

from __future__ import annotations

import os
import re
import traceback
from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Any


class FfsmsError(Exception):
    """The root of every error that the library raises on purpose; its text is one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(message.split()))

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[Any, ...]:
        # The constructors of the subclasses take values, not the text: without this an error could not come
        # back from a worker process.
        return type(self).__new__, (type(self),), {"args": self.args, **self.__dict__}


class InvalidValue(FfsmsError, ValueError):
    """An argument has a value, shape or type that cannot be used.

    Attributes
    ----------
    name : str
        The argument.
    value : object
        What was given.
    """

    def __init__(self, name: str, value: Any, expected: str) -> None:
        super().__init__(f"{name} {expected}, got {short(value)}")
        self.name, self.value = name, value


class UnknownOption(InvalidValue, TypeError):
    """A function was called with an argument that it does not take."""

    def __init__(self, function: str, name: str, value: Any, known: Iterable[str], instead: str = "") -> None:
        known = list(known)
        remedy = instead or meant(name, known) or f"there are {', '.join(known)}"
        super().__init__(name, value, f"is no argument of {function}; {remedy}")


def meant(name: str | Path, known: Iterable[str], before: str = "") -> str:
    """Return a question with the known name that is most like another, after `before`; "" if none is near.

    Dashes in front of options do not count as letters in common.
    """
    bare = {known_name.lstrip("-"): known_name for known_name in known}
    near = get_close_matches(str(name).lstrip("-"), list(bare), n=1, cutoff=0.54)
    return f"{before}did you mean '{bare[near[0]]}'?" if near else ""


def advised(message: str, advice: str, known: Container[str] | None = None) -> str:
    """Return an error's text with advice for Python (`load(..., key=VALUE)`, `mount`) as `advice` puts it.

    `advice` is a format with {key}, {option} (the key as the command line spells it), {value}, and {listed},
    the value as TOML spells it; keys that are not `known` stay as they are.
    """

    def written(match: re.Match[str]) -> str:
        if known is not None and match[1] not in known:
            return match[0]
        listed = match[2].translate(str.maketrans("()", "[]"))
        return advice.format(key=match[1], option=match[1].replace("_", "-"), value=match[2], listed=listed)

    message = re.sub(r" or sms\.\w+\([^)]*\)", "", message)
    message = re.sub(r"ffsms_pin\.mount(\('[^']*'\))?", "[robot.mount] of a scenario file", message)
    return re.sub(r"load\(\.\.\., (\w+)=(\([^)]*\)|[^)]*)\)", written, message)


class PartError(FfsmsError, ValueError):
    """A term or a limit gives something that cannot be used, or fails.

    Attributes
    ----------
    part : str
        Its class.
    method : str
    """

    def __init__(self, part: object, method: str, problem: str) -> None:
        self.part = part.__name__ if isinstance(part, type) else type(part).__name__
        self.method = method
        super().__init__(f"{self.part}.{method} {problem}")

    @classmethod
    def of(cls, part: object, method: str, error: Exception) -> PartError:
        """Make the error for an exception inside a part."""
        return cls(part, method, f"failed with {type(error).__name__}: {error}")


class ModelNotFound(FfsmsError, FileNotFoundError):
    """An unknown name of a robot, neither packaged nor a file; `remedy` replaces a similar name as advice."""

    def __init__(self, name: str | Path, packaged: Sequence[str], remedy: str = "") -> None:
        super().__init__(
            f"no robot '{name}': it is neither a file nor a packaged model "
            f"(packaged: {', '.join(packaged)}); {remedy or meant(name, packaged) or 'check the path'}"
        )
        self.model, self.packaged = str(name), list(packaged)


class InvalidUrdf(FfsmsError, ValueError):
    """A file cannot be read as a robot description.

    Attributes
    ----------
    source : str
        The file.
    """

    def __init__(self, source: str | Path, problem: str) -> None:
        super().__init__(f"{source}: {problem}")
        self.source, self.problem = str(source), problem


class InvalidInertia(InvalidUrdf):
    """A link's mass or inertia is missing or cannot belong to a rigid body.

    Attributes
    ----------
    link : str
        The link.
    """

    def __init__(self, source: str | Path, link: str, problem: str) -> None:
        super().__init__(source, f"link '{link}' {problem}")
        self.link = link


class UnsupportedJoint(InvalidUrdf):
    """A joint is of a type with several degrees of freedom, or the robot has no joint at all."""


class FrameNotFound(FfsmsError, KeyError):
    """A frame name is not in the model.

    Attributes
    ----------
    frame : str
        The name that was asked for.
    available : list of str
        The names that exist.
    """

    def __init__(self, frame: str, available: Sequence[str]) -> None:
        super().__init__(f"no frame '{frame}' in the model; frames: {', '.join(available)}")
        self.frame, self.available = frame, list(available)


class AmbiguousEndEffector(FfsmsError, ValueError):
    """The robot has several last links, so the end effector must be named."""

    def __init__(self, candidates: Sequence[str]) -> None:
        super().__init__(
            f"the robot has {len(candidates)} last links ({', '.join(candidates)}); "
            "say which one is the end effector: load(..., end_effector=NAME) or sms.with_end_effector(NAME)"
        )
        self.candidates = list(candidates)


class GeometryError(FfsmsError, RuntimeError):
    """The shapes of a robot cannot be had: a mesh that is not there or cannot be read."""


class DependencyMissing(FfsmsError, ImportError):
    """A package that only parts of the library need is not installed."""

    def __init__(self, package: str, needed_for: str, extra: str) -> None:
        super().__init__(f"{needed_for} needs the package '{package}': pip install 'ffsms-pin[{extra}]'")
        self.package, self.extra = package, extra


# Extra of pyproject.toml -> the modules that it brings.
EXTRAS = {
    "plot": ("matplotlib",),
    "view": ("meshcat", "umsgpack"),
    "robots": ("example_robot_data",),
    "mjcf": ("mujoco",),
    "cluster": ("dask", "distributed"),
}


def installed(extra: str) -> bool:
    """Return whether every module of an extra can be imported."""
    return all(find_spec(module) is not None for module in EXTRAS[extra])


def require(extra: str, needed_for: str) -> None:
    """Raise `DependencyMissing` with the command that installs an extra, where one of its modules is missing.

    Parameters
    ----------
    extra : str
        A key of `EXTRAS`.
    needed_for : str
        What cannot be done without it, the subject of the message.
    """
    for module in EXTRAS[extra]:
        if find_spec(module) is None:
            raise DependencyMissing(module, needed_for, extra)


class InvalidScenario(FfsmsError, ValueError):
    """A scenario file is missing, is not TOML, or holds a key or value that cannot be used."""

    def __init__(self, source: str | Path, problem: str) -> None:
        super().__init__(f"scenario {source}: {problem}")
        self.source = str(source)


class NumericalError(FfsmsError, ArithmeticError):
    """A calculation failed in its numbers: a matrix was singular, or an iteration did not converge.

    Attributes
    ----------
    task : str
        The calculation.
    """

    def __init__(self, task: str, error: Exception) -> None:
        remedy = "check for masses, inertias, lengths, gains or time steps whose sizes are very far apart"
        super().__init__(f"{task} failed in its numbers ({type(error).__name__}: {error}); {remedy}")
        self.task = task


class SimulationDiverged(FfsmsError, ArithmeticError):
    """A simulated state, or a torque of the controller, stopped being finite.

    Attributes
    ----------
    time : float
        The last instant with finite values [s].
    tracking : object
        What was recorded up to that instant.
    """

    def __init__(
        self,
        time: float,
        tracking: Any = None,
        saved: str = "",
        what: str = "the simulated state is not finite after",
    ) -> None:
        super().__init__(f"{what} t = {time:.6g} s; use a smaller dt or softer gains{saved and '; '}{saved}")
        self.time, self.tracking = time, tracking


class ResultError(FfsmsError, OSError):
    """A result file cannot be read or written.

    Attributes
    ----------
    path : str
    problem : str
    """

    def __init__(self, path: str | os.PathLike[str], problem: str) -> None:
        super().__init__(f"{os.fspath(path)}: {problem}")
        self.path, self.problem = str(path), problem


class TaskError(FfsmsError, RuntimeError):
    """A failure of a task in another process whose own error could not be sent back."""


class TasksFailed(FfsmsError, RuntimeError):
    """A failure of some of many tasks.

    Attributes
    ----------
    failures : dict of int to Exception
        Why, by the place of the task in the sequence.
    results : list
        The results of all tasks; None for those that failed.
    """

    def __init__(self, failures: dict[int, Exception], results: list[Any]) -> None:
        index, error = next(iter(failures.items()))
        super().__init__(
            f"{len(failures)} of {len(results)} tasks failed, the first at index {index} "
            f"({type(error).__name__}: {error}); the error's `results` has the others"
        )
        self.failures, self.results = failures, results


class ClusterError(FfsmsError, RuntimeError):
    """The scheduler of a distributed run, or its workers, are not there or gone."""


class FfsmsWarning(UserWarning):
    """The root of the library's warnings."""


def short(value: Any) -> str:
    """Return the text of a value for messages: one line of at most 80 characters."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a number of more digits than Python writes, or an object that fails to tell its name
        text = f"an object of class {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."


# Their frames are passed over in the search for the code that called them.
_LIBRARIES = frozenset({"numpy", "scipy", "pinocchio", "coal", "proxsuite", "daqp", "contextlib"})


@contextmanager
def numerical_errors(task: str) -> Iterator[None]:
    """Raise `NumericalError` for what NumPy, SciPy, Pinocchio or a solver raises; also a decorator.

    It stands around the calls that users make, such as a plan or a simulation. An exception from a user's own
    function, a controller or a term of a plan, passes as it is.
    """
    try:
        yield
    except FfsmsError:
        raise
    except (ArithmeticError, ValueError, RuntimeError) as error:
        modules = (frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__))
        callers = [name for module in modules if (name := module.partition(".")[0]) not in _LIBRARIES]
        if callers[-1] != __package__:
            raise
        raise NumericalError(task, error) from error


_KINDS = (FfsmsError, FfsmsWarning)
__all__ = [name for name, kind in globals().items() if isinstance(kind, type) and issubclass(kind, _KINDS)]
