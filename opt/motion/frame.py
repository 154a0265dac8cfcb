"""Positions of frames of the robot as features, with what belongs to a frame: its axes, its turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature, Where, during
from ffsms_pin.system.batch.stacks import apply, dot, exp3, log3, skew

__all__ = ["EYE", "Frame", "carried"]

_ROUNDING = 1e-9  # [rad] keeps the slope of an angle finite where it is zero
EYE = np.eye(3)[..., None, None]  # slopes of a vector by itself


class Frame(Feature):
    """The position (3, S, K) of a frame, inertial axes [m]: a feature.

    Parameters
    ----------
    position : ndarray, shape (3, S, K)
    rotation : ndarray, shape (3, 3, S, K)
        Its attitude.
    slopes : dict of str to ndarray
        Of the position.
    turns : dict of str to ndarray, shape (3, ..., S, K)
        Of a turn of the frame (rotation vector, inertial axes): components first.
    where : tuple of ndarray, optional
        See `Feature`.
    """

    def __init__(
        self,
        position: FloatArray,
        rotation: FloatArray,
        slopes: dict[str, FloatArray],
        turns: dict[str, FloatArray],
        where: Where | None = None,
    ) -> None:
        super().__init__(position, slopes, where)
        self.rotation, self._turns = rotation, turns

    @property
    def position(self) -> Frame:
        """The position: the frame itself."""
        return self

    def axis(self, axis: Any) -> Feature:
        """A direction (3,) that is given in the frame's axes, in inertial axes (3, S, K)."""
        a = apply(self.rotation, np.asarray(axis, dtype=np.float64)[:, None, None])
        return self._turned(a, -skew(a))  # a turn phi moves it by phi x a

    def turn_from(self, rotation: FloatArray) -> Feature:
        """Rotation vector (3, S, K), inertial axes, that takes an attitude (3, 3) or (3, 3, K) here [rad]."""
        r = self._from(rotation)
        # log(exp(phi) X) = r + J_l^-1(r) phi. Reference: J. Sola et al., "A micro Lie theory", 2018, eq. 146.
        angle = np.clip(np.sqrt(dot(r, r)), 1e-4, np.pi - 1e-3)
        factor = 1.0 / angle**2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
        R = skew(r)
        return self._turned(r, EYE - 0.5 * R + factor * apply(R, R))

    def angle_from(self, rotation: FloatArray) -> Feature:
        """Its length (S, K) [rad]: how far the frame has turned from an attitude."""
        r = self._from(rotation)
        angle = np.sqrt(dot(r, r) + _ROUNDING**2)
        # Along its axis a turn adds to the angle, across it does not.
        return Feature(angle, Feature(r, self._turns)._along(r / angle, {}), self.where)

    def during(self, span: slice) -> Frame:
        """The same at some of its instants, one after the other; of all motions."""
        value, slopes, where = self._during(span)
        return Frame(value, self.rotation[..., span], slopes, during(self._turns, span), where)

    def moving_on(self, velocity: Feature, spin: Feature, by: FloatArray) -> Frame:
        """The frame so much later (S, K) [s], going straight on."""
        position, turn = self + by * velocity, exp3(by * spin.value)
        turns = {name: apply(turn, slope) for name, slope in self._turns.items()}
        turns.update({name: by * slope for name, slope in spin.slopes.items()})
        return Frame(position.value, apply(turn, self.rotation), position.slopes, turns, self.where)

    def _from(self, rotation: FloatArray) -> FloatArray:
        start = rotation.reshape(3, 3, 1, -1)
        return log3(np.einsum("xy...,zy...->xz...", self.rotation, start))

    def _turned(self, value: FloatArray, slope: FloatArray) -> Feature:
        """A vector with its slopes (3, 3, S, K) by a turn of the frame."""
        found = {name: slope if turn is EYE else apply(slope, turn) for name, turn in self._turns.items()}
        return Feature(value, found, self.where)


def carried(
    lever: FloatArray, by_joints: FloatArray, axes: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Slopes of the position and of a turn of a frame that the base carries.

    Parameters
    ----------
    lever : ndarray, shape (3, S, K)
        From the base's centre of mass to the frame, inertial axes [m].
    by_joints, axes : ndarray, shape (3, n, S, K)
        What a unit rate of each joint moves and turns it by, on a base at rest, inertial axes.
    """
    place = {"by_base": EYE, "by_base_turn": -skew(lever), "by_joints": by_joints}
    return place, {"by_base_turn": EYE, "by_joints": axes}
