"""What becomes of one task: a result, or the error that it raised. Each works on copies of its own."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from ffsms_pin.errors import TaskError

__all__ = ["Answer", "Common", "answer", "answers", "copied", "packed", "unpacked"]

# What is the same for all tasks: `work(shared, task)`, and `shared`.
Common = tuple[Callable[[Any, Any], Any], Any]
# Result and error of a task; one of them is None.
Answer = tuple[Any, Exception | None]


@dataclass(frozen=True)
class _Unsent:
    """Stands for a task or a result that cannot be pickled."""

    error: TaskError


def copied(thing: Any) -> Any:
    """A copy that shares nothing with the original.

    cloudpickle copies what functions remember too, as on the way to a worker. Where it is not installed there
    are no workers that would have to come to the same, and functions stay what they are.
    """
    try:
        import cloudpickle
    except ImportError:
        return deepcopy(thing)
    return pickle.loads(cloudpickle.dumps(thing))


def packed(thing: Any) -> bytes:
    """A task or an answer as bytes; what cannot be pickled becomes its error."""
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(thing)
    except Exception as error:  # whatever its class makes of being copied
        data = pickle.dumps(_Unsent(_told(error)))
    return data


def answers(common: Common, tasks: list[bytes]) -> list[bytes]:
    """In a worker: what became of some tasks."""
    return [packed(answer(common, lambda data=data: pickle.loads(data))) for data in tasks]  # type: ignore[misc]


def answer(common: Common, task: Callable[[], Any]) -> Answer:
    """What became of the task that a function gives."""
    work, shared = common
    try:
        own = task()
        if isinstance(own, _Unsent):
            return None, own.error
        return work(shared, own), None
    except Exception as error:
        return None, _portable(error)


def unpacked(data: bytes) -> Answer:
    """The answer that a worker sent."""
    found = pickle.loads(data)
    return (None, found.error) if isinstance(found, _Unsent) else found


def _portable(error: Exception) -> Exception:
    """The error, or its text where it does not survive being sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # likewise
        return _told(error)
    return error


def _told(error: Exception) -> TaskError:
    return TaskError(f"{type(error).__name__}: {error}")
