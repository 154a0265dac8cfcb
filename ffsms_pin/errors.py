"""The errors of the library: a root class, and a subclass for each cause."""

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
    """The root class of the library's errors; each message has one line."""

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(message.split()))

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[Any, ...]:
        # Subclasses are constructed from values, not from the text. Without this method an error could not
        # be returned from a worker process.
        return type(self).__new__, (type(self),), {"args": self.args, **self.__dict__}


class InvalidValue(FfsmsError, ValueError):
    """An argument has a value, shape or type that cannot be used.

    Attributes
    ----------
    name : str
        The argument.
    value : object
        The value of the argument.
    reason : str
        The reason for the error, without argument, value and remedy. Default: the requirement in the message.
    """

    def __init__(self, name: str, value: Any, expected: str, reason: str = "") -> None:
        super().__init__(f"{name} {expected}, got {short(value)}")
        self.name, self.value, self.reason = name, value, reason or expected


class UnknownOption(InvalidValue, TypeError):
    """A function was called with an argument that it does not take."""

    def __init__(self, function: str, name: str, value: Any, known: Iterable[str], instead: str = "") -> None:
        known = list(known)
        remedy = instead or meant(name, known) or f"its arguments are {', '.join(known)}"
        super().__init__(name, value, f"is not an argument of {function}; {remedy}")


def meant(name: str | Path, known: Iterable[str], before: str = "") -> str:
    """Return "did you mean NAME?" with the known name most similar to `name`; "" if none is similar.

    `before` is put in front of the question. Leading dashes of options are ignored.
    """
    bare = {known_name.lstrip("-"): known_name for known_name in known}
    near = get_close_matches(str(name).lstrip("-"), list(bare), n=1, cutoff=0.54)
    return f"{before}did you mean '{bare[near[0]]}'?" if near else ""


def advised(message: str, advice: str, known: Container[str] | None = None) -> str:
    """Replace advice on Python calls in an error's text, such as `load(..., key=VALUE)`, by `advice`.

    `advice` is a format with {key}, {option} (the key as an option of the command line), {value}, and
    {listed} (the value in TOML). Advice on keys that are not in `known` is not replaced. `ffsms_pin.mount`
    is replaced by the scenario key. Alternative advice on methods of the robot is deleted.
    """

    def replacement(match: re.Match[str]) -> str:
        if known is not None and match[1] not in known:
            return match[0]
        listed = match[2].translate(str.maketrans("()", "[]"))
        return advice.format(key=match[1], option=match[1].replace("_", "-"), value=match[2], listed=listed)

    message = re.sub(r" or sms\.\w+\([^)]*\)", "", message)
    message = re.sub(r"ffsms_pin\.mount(\('[^']*'\))?", "[robot.mount] of a scenario file", message)
    return re.sub(r"load\(\.\.\., (\w+)=(\([^)]*\)|[^)]*)\)", replacement, message)


class PartError(FfsmsError, ValueError):
    """A term or a limit of a plan returns an unusable value, or fails.

    Attributes
    ----------
    part : str
        The class of the term or limit.
    method : str
        The method that failed.
    """

    def __init__(self, part: object, method: str, problem: str) -> None:
        self.part = part.__name__ if isinstance(part, type) else type(part).__name__
        self.method = method
        super().__init__(f"{self.part}.{method} {problem}")

    @classmethod
    def of(cls, part: object, method: str, error: Exception) -> PartError:
        """Make the error from an exception in a method of a term or limit."""
        return cls(part, method, f"failed with {type(error).__name__}: {error}")


class ModelNotFound(FfsmsError, FileNotFoundError):
    """The argument is neither the name of a packaged model nor the path of an existing file.

    `remedy` is the advice in the message. Default: a question with a similar name, or to check the path.
    """

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
        super().__init__(f"{source}: {problem}" if str(source) else problem)  # a model may have no name
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
    """The robot has no movable joint, or an unsupported one, such as one with several degrees of freedom."""


class FrameNotFound(FfsmsError, KeyError):
    """A frame name is not in the model.

    Attributes
    ----------
    frame : str
        The requested name.
    available : list of str
        The existing names.
    """

    def __init__(self, frame: str, available: Sequence[str]) -> None:
        super().__init__(f"no frame '{frame}' in the model; frames: {', '.join(available)}")
        self.frame, self.available = frame, list(available)


class AmbiguousEndEffector(FfsmsError, ValueError):
    """The robot has several last links, so the end effector must be named."""

    def __init__(self, candidates: Sequence[str]) -> None:
        super().__init__(
            f"the robot has {len(candidates)} last links ({', '.join(candidates)}); "
            "choose the end effector: load(..., end_effector=NAME) or sms.with_end_effector(NAME)"
        )
        self.candidates = list(candidates)


class GeometryError(FfsmsError, RuntimeError):
    """The shapes of a robot cannot be loaded, drawn or exported, for example because a mesh is missing."""


class DependencyMissing(FfsmsError, ImportError):
    """An optional package is not installed."""

    def __init__(self, package: str, needed_for: str, extra: str) -> None:
        super().__init__(f"{needed_for} needs the package '{package}': pip install 'ffsms-pin[{extra}]'")
        self.package, self.extra = package, extra


# The modules of the extras of pyproject.toml that the library can use.
EXTRAS = {
    "plot": ("matplotlib",),
    "view": ("meshcat", "umsgpack"),
    "robots": ("example_robot_data",),
    "mjcf": ("mujoco",),
    "cluster": ("dask", "distributed"),
}


def installed(extra: str) -> bool:
    """Return whether every module of an extra is installed."""
    return all(find_spec(module) is not None for module in EXTRAS[extra])


def require(extra: str, needed_for: str) -> None:
    """Raise `DependencyMissing`, with the command that installs the extra, if one of its modules is missing.

    Parameters
    ----------
    extra : str
        A key of `EXTRAS`.
    needed_for : str
        The feature that needs the extra, the subject of the message.
    """
    for module in EXTRAS[extra]:
        if find_spec(module) is None:
            raise DependencyMissing(module, needed_for, extra)


class InvalidScenario(FfsmsError, ValueError):
    """A scenario file is missing, is not TOML, or contains a key or value that cannot be used."""

    def __init__(self, source: str | Path, problem: str) -> None:
        super().__init__(f"scenario {source}: {problem}")
        self.source = str(source)


class NumericalError(FfsmsError, ArithmeticError):
    """A calculation failed numerically: a matrix was singular, or an iteration did not converge.

    Attributes
    ----------
    task : str
        The calculation.
    """

    def __init__(self, task: str, error: Exception) -> None:
        remedy = "check for masses, inertias, lengths, gains or time steps of very different magnitudes"
        super().__init__(f"{task} failed numerically ({type(error).__name__}: {error}); {remedy}")
        self.task = task


class SimulationDiverged(FfsmsError, ArithmeticError):
    """A simulated state, or a command of a controller, is no longer finite.

    Attributes
    ----------
    time : float
        The last instant with finite values [s].
    tracking : object
        The recording up to that instant.
    """

    def __init__(
        self,
        time: float,
        tracking: Any = None,
        saved: str = "",
        what: str = "the simulated state is not finite after",
    ) -> None:
        remedy = "use a smaller dt or softer gains, or correct a controller of your own"
        super().__init__(f"{what} t = {time:.6g} s; {remedy}{saved and '; '}{saved}")
        self.time, self.tracking = time, tracking


class ResultError(FfsmsError, OSError):
    """A result file cannot be read or written.

    Attributes
    ----------
    path : str
        The file.
    problem : str
        The reason.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str) -> None:
        super().__init__(f"{os.fspath(path)}: {problem}")
        self.path, self.problem = str(path), problem


class TaskError(FfsmsError, RuntimeError):
    """A task could not be sent to another process, or its process died."""


class TasksFailed(FfsmsError, RuntimeError):
    """Some tasks of a sequence failed.

    Attributes
    ----------
    failures : dict of int to Exception
        The errors by index of the task in the sequence.
    results : list
        The results of all tasks; None for failed tasks.
    """

    def __init__(self, failures: dict[int, Exception], results: list[Any]) -> None:
        index, error = next(iter(failures.items()))
        super().__init__(
            f"{len(failures)} of {len(results)} tasks failed, the first at index {index} "
            f"({type(error).__name__}: {error}); the error's `results` has the others"
        )
        self.failures, self.results = failures, results


class ClusterError(FfsmsError, RuntimeError):
    """The scheduler of a distributed run, or its workers, cannot be reached."""


class FfsmsWarning(UserWarning):
    """The class of the library's warnings, except deprecations."""


def length_text(metres: float) -> str:
    """Return a length with its unit: millimetres below 1 m, else metres."""
    return f"{1e3 * metres:.3g} mm" if abs(metres) < 1.0 else f"{metres:.4g} m"


def short(value: Any) -> str:
    """Return the text of a value for messages: one line of at most 80 characters."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an integer too long for str, or an object whose repr fails
        text = f"an object of class {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."


# Libraries whose stack frames are skipped in the search for the code that raised an error.
_LIBRARIES = frozenset({"numpy", "scipy", "pinocchio", "coal", "proxsuite", "daqp", "contextlib"})


@contextmanager
def numerical_errors(task: str) -> Iterator[None]:
    """Convert errors of NumPy, SciPy, Pinocchio and solvers into `NumericalError`; also a decorator.

    `numerical_errors` wraps functions that users call, such as `opt.plan` or `simulate`. Exceptions of a
    user's own function, controller or term are not converted.
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
