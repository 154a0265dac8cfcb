"""What a closed-loop simulation recorded."""

from __future__ import annotations

import os
from dataclasses import Field, dataclass, fields
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.errors import ResultError
from ffsms_pin.simulation.streaming import recorded, save_mapped
from ffsms_pin.storage import load_arrays, path_like, save_arrays

__all__ = ["Tracking"]

_FORMAT = "ffsms-pin tracking"


@dataclass(frozen=True, eq=False)  # arrays have no single truth value to compare by
class Tracking:
    """A simulated motion of the plant over N control steps; all arrays are read-only.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        [s]
    q : ndarray, shape (N + 1, nq)
        Configuration of the plant, Pinocchio's.
    v : ndarray, shape (N + 1, 6 + n)
        Velocity of the plant, Pinocchio's.
    tau : ndarray, shape (N, n)
        Joint torques [N m], each held over its step.
    joint_error : ndarray, shape (N + 1, n)
        q - q_d [rad]; for continuous joints the shorter way round.
    joint_rate_error : ndarray, shape (N + 1, n)
        qd - qd_d [rad/s].
    position_error : ndarray, shape (N + 1,)
        Distance from the plant's end effector to the target [m].
    momentum : ndarray, shape (N + 1, 6)
        Total momentum [linear; angular] [kg m/s; kg m^2/s], inertial axes, about the centre of mass.
    kinetic_energy : ndarray, shape (N + 1,)
        [J]
    work : ndarray, shape (N + 1,)
        Work done on the plant since the start [J]: by torques, friction and external forces, and the energy
        that captures and locking joints took.
    note : str
        What happened, and when; empty where nothing did.
    """

    t: FloatArray
    q: FloatArray
    v: FloatArray
    tau: FloatArray
    joint_error: FloatArray
    joint_rate_error: FloatArray
    position_error: FloatArray
    momentum: FloatArray
    kinetic_energy: FloatArray
    work: FloatArray
    note: str = ""

    def __post_init__(self) -> None:
        for field in _arrays():
            value = getattr(self, field.name)
            # The rows of a run that was streamed to disk stay there.
            array = value if isinstance(value, np.memmap) else np.array(value, dtype=np.float64)
            object.__setattr__(self, field.name, frozen(array))

    @property
    def energy_error(self) -> FloatArray:
        """Gain of kinetic energy less work (N + 1,) [J]: the integrator's error and rounding."""
        error: FloatArray = self.kinetic_energy - self.kinetic_energy[0] - self.work
        return error

    @property
    def effort(self) -> float:
        """Integral of the square of the torques [N^2 m^2 s]."""
        return float((self.tau**2).sum()) * self._dt

    @property
    def chatter(self) -> float:
        """Integral of the square of the torques' rate, by differences [N^2 m^2 / s]."""
        return float((np.diff(self.tau, axis=0) ** 2).sum()) / self._dt if len(self.tau) > 1 else 0.0

    @property
    def _dt(self) -> float:
        return float(self.t[-1] - self.t[0]) / max(len(self.t) - 1, 1)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an npz file, atomically."""
        save = save_mapped if isinstance(self.t, np.memmap) else save_arrays
        save(path, _FORMAT, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Tracking:
        """Read what `save` wrote; a `ResultError` says what is wrong with another file.

        Of a streamed run that was interrupted, the rows that it left; its `note` says so.
        """
        path = path_like("path", path)
        partial = recorded(path)
        if partial is not None:
            missing = [field.name for field in _arrays() if field.name not in partial]
            if missing:
                raise ResultError(path, f"was left unfinished and lacks {', '.join(missing)}")
            _check_shapes(path, partial)
            return cls(**partial, note="interrupted: this is what was recorded until then")
        arrays = load_arrays(path, _FORMAT, [field.name for field in fields(cls)])
        note = str(arrays.pop("note"))
        _check_shapes(path, arrays)
        return cls(**arrays, note=note)


def _arrays() -> list[Field[Any]]:
    return [field for field in fields(Tracking) if field.name != "note"]


def _check_shapes(path: str | os.PathLike[str], arrays: dict[str, Any]) -> None:
    """Raise `ResultError` unless the arrays are numbers and fit together."""
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu":
            raise ResultError(path, f"holds no numbers in {name}")
    nodes = arrays["t"].size
    n = arrays["v"].shape[1] - 6 if arrays["v"].ndim == 2 else 0
    nq = arrays["q"].shape[1] if arrays["q"].ndim == 2 else 0
    wanted = {
        "t": (nodes,),
        "v": (nodes, 6 + n),
        "q": (nodes, max(nq, 7 + n)),
        "tau": (nodes - 1, n),
        "joint_error": (nodes, n),
        "joint_rate_error": (nodes, n),
        "position_error": (nodes,),
        "momentum": (nodes, 6),
        "kinetic_energy": (nodes,),
        "work": (nodes,),
    }
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            raise ResultError(path, f"holds {name} of shape {arrays[name].shape} where {shape} would fit")
