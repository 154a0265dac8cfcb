"""What the live page shows: the latest command of each kind for each node, in the order of arrival."""

from __future__ import annotations

import threading

from ffsms_pin.errors import ViewerError

__all__ = ["SceneLog"]

# What draws and moves things. Meshcat's page knows more commands, and one of them (`set_control`) evaluates
# a text that comes with it: none of those ever leaves this process.
_KINDS = ("set_object", "set_transform", "set_property", "set_animation", "delete")


class SceneLog:
    """Written by the thread that draws, read by the thread that serves.

    A page that is too slow for every command skips those that later ones have replaced, so what is kept is
    bounded by the scene, not by the length of the run.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0
        # By kind, path and property: the command's number and the packed command. A dict keeps its order;
        # a command that replaces another one goes to the end.
        self._latest: dict[tuple[str, str, str], tuple[int, bytes]] = {}

    def put(self, kind: str, path: str, name: str, packed: bytes) -> None:
        """Take one command.

        Parameters
        ----------
        kind : str
            Type of the command.
        path : str
            Of the node.
        name : str
            Of the property, for `set_property`; otherwise empty.
        packed : bytes
            The whole command.

        Raises
        ------
        ViewerError
            A kind of command that the live page is not sent.
        """
        if kind not in _KINDS:
            raise ViewerError(f"the live page is not sent commands of the kind '{kind}'; use {_KINDS}")
        with self._lock:
            if kind == "delete":
                below = path.rstrip("/") + "/"
                self._drop([key for key in self._latest if (key[1] + "/").startswith(below)])
            elif kind == "set_object":  # a new object has its properties still to come
                self._drop([key for key in self._latest if key[:2] == ("set_property", path)])
            self._count += 1
            self._drop([(kind, path, name)])
            self._latest[kind, path, name] = (self._count, packed)

    def since(self, count: int) -> tuple[int, list[bytes]]:
        """What came after the first `count` commands.

        Parameters
        ----------
        count : int
            What the last call returned; 0 for a new page.

        Returns
        -------
        count : int
            Number of commands so far.
        commands : list of bytes
            In order, without those that later ones replaced.
        """
        found: list[bytes] = []
        with self._lock:
            for number, packed in reversed(self._latest.values()):
                if number <= count:
                    break
                found.append(packed)
            return self._count, found[::-1]

    def _drop(self, keys: list[tuple[str, str, str]]) -> None:
        for key in keys:
            self._latest.pop(key, None)
