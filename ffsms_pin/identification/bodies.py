"""The bodies with unknown inertial parameters: their names, their columns, and their priors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, instance, positive, rigid_body
from ffsms_pin.errors import InvalidValue, meant
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.regressors import PER_BODY

PARAMETERS = ("m", "m cx", "m cy", "m cz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
PAYLOAD = "payload"
_MASSLESS = 1e-9  # mass and inertia of a payload without a prior, as a share of the robot's


@dataclass(frozen=True, eq=False)
class UnknownBody:
    """A body with unknown inertial parameters.

    Attributes
    ----------
    name : str
        "base", "payload", or the name of a link or joint.
    index : int
        The index of the body in the model, or of the body that carries the payload: 0 is the base, i the
        body of joint i - 1.
    added : bool
        True for a payload, which adds to the body `index`; False for that body itself.
    believed : ndarray, shape (10,)
        The prior parameters in the frame of body `index`.
    deviation : ndarray, shape (10,)
        Standard deviations of `believed`.
    free : ndarray of bool, shape (10,)
        True for the parameters that are estimated; the others are known.
    """

    name: str
    index: int
    added: bool
    believed: FloatArray
    deviation: FloatArray
    free: Any


class Known(NamedTuple):
    """The robot with the inertias of `known`, the known masses by body name, and the prior of the payload."""

    sms: SpaceManipulator
    masses: dict[str, float]
    payload: Any


def known_bodies(sms: SpaceManipulator, known: Mapping[str, Any]) -> Known:
    """Return the model, known masses and prior payload that follow from the argument `known`."""
    instance("known", known, Mapping)
    inertias, masses, payload = list(sms.model.inertias)[1:], dict[str, float](), None
    for name, value in known.items():
        index = None if name == PAYLOAD else _index(sms, name, "known")
        if not isinstance(value, pin.Inertia):
            masses[name] = positive(f"known.{name}", value, "kg")
            continue
        rigid_body(f"known.{name}", float(value.mass), value.inertia, value.lever)
        if index is None:
            payload = value
        else:
            inertias[index] = value
    return Known(sms.with_inertias(inertias), masses, payload)


def unknown_bodies(known: Known, unknown: Sequence[str], spread: float) -> list[UnknownBody]:
    """Return the unknown bodies by name.

    The prior deviations are `spread` times a body's own mass, first moments and inertia; for a payload
    without a prior they have the size of the whole robot's.
    """
    if isinstance(unknown, str) or not isinstance(unknown, Sequence) or not unknown:
        example = "a list of names such as ['base'], ['base', 'payload'] or link names"
        raise InvalidValue("unknown", unknown, f"must be {example}")
    spread = positive("spread", spread)
    bodies = [_unknown(known, name, spread) for name in unknown]
    if strangers := [name for name in known.masses if name not in unknown]:
        text = f"holds the mass of '{strangers[0]}', which is not among the unknown bodies; to change the"
        raise InvalidValue("known", known.masses, f"{text} model, give its inertia, too (pinocchio.Inertia)")
    if known.payload is not None and PAYLOAD not in unknown:
        text = "holds an inertia of the payload, which is not among the unknown bodies; add a known payload"
        raise InvalidValue("known", known.payload, f"{text} to the robot with sms.with_inertias")
    indices = [body.index for body in bodies]
    if len(set(indices)) < len(indices):
        text = "must name each body once; a payload cannot be distinguished from the link that carries it"
        raise InvalidValue("unknown", list(unknown), text)
    return bodies


def _unknown(known: Known, name: str, spread: float) -> UnknownBody:
    sms, mass, added = known.sms, known.masses.get(name), name == PAYLOAD
    index = int(sms.model.frames[sms.frame_id].parentJoint) - 1 if added else _index(sms, name, "unknown")
    if added and known.payload is None:
        whole = sum(float(body.mass) for body in list(sms.model.inertias)[1:])
        base = sms.model.inertias[1]
        deviation = _scales(whole, math.sqrt(float(np.trace(base.inertia)) / 2.0 / base.mass))
        body = pin.Inertia(_MASSLESS * whole, np.zeros(3), _MASSLESS * deviation[4] * np.eye(3))
        believed = np.array(body.toDynamicParameters())
    else:
        body = known.payload if added else sms.model.inertias[index + 1]
        believed = np.array(body.toDynamicParameters())
        if not believed[0] > 0.0:
            raise InvalidValue("unknown", name, "must have mass, but its mass in the model is zero")
        about_origin = float(believed[4] + believed[6] + believed[9])
        deviation = spread * _scales(believed[0], math.sqrt(about_origin / 2.0 / believed[0]))
    free = np.ones(PER_BODY, dtype=bool)
    if mass is not None:
        believed *= mass / believed[0]
        free[0] = False
        deviation[0] = 0.0
    return UnknownBody(name, index, added, believed, deviation, free)


def _scales(mass: float, length: float) -> FloatArray:
    return np.array([mass, *[mass * length] * 3, *[mass * length**2] * 6])


def _index(sms: SpaceManipulator, name: Any, argument: str) -> int:
    """Return the index of a body by the name of its link or joint, or "base"."""
    model = sms.model
    names = {"base": 0} | {str(model.names[j]): j - 1 for j in range(2, model.njoints)}
    for frame in model.frames:
        joint = int(frame.parentJoint)
        if frame.type == pin.FrameType.BODY and joint > 0:
            names.setdefault(str(frame.name), joint - 1)
    if not isinstance(name, str) or name not in names:
        payload = ", the payload" if argument == "unknown" else ""
        text = f"must name the base{payload} or a link of the robot ({', '.join(names)})"
        raise InvalidValue(argument, name, text + meant(str(name), names, "; "))
    return names[name]
