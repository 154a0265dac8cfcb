"""The bodies with unknown inertial parameters, and their priors."""

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
_MASSLESS = 1e-9  # mass and inertia of a payload without a prior, as a share of their deviations


@dataclass(frozen=True, eq=False)
class UnknownBody:
    """A body with unknown inertial parameters.

    Attributes
    ----------
    name : str
        "base", "payload", or the name of a link or joint.
    index : int
        The index of the body: 0 for the base, i + 1 for the body that joint i moves (i from 0). A payload has
        the index of the link that carries it.
    added : bool
        True for a payload, whose parameters add to those of the body `index`.
    believed : ndarray, shape (10,)
        The prior parameters in the frame of body `index`, in Pinocchio's order.
    deviation : ndarray, shape (10,)
        The standard deviations of the prior parameters.
    free : ndarray of bool, shape (10,)
        True for the estimated parameters, False for the known parameters.
    """

    name: str
    index: int
    added: bool
    believed: FloatArray
    deviation: FloatArray
    free: Any


class Known(NamedTuple):
    """The robot with the known inertias, the known masses [kg] by body, and the payload's prior inertia."""

    sms: SpaceManipulator
    masses: dict[str, float]
    payload: Any


def known_bodies(sms: SpaceManipulator, known: Mapping[str, Any]) -> Known:
    """Check the argument `known` of `Identifier`, and return its values by kind."""
    instance("known", known, Mapping)
    inertias, masses, payload = list(sms.model.inertias)[1:], dict[str, float](), None
    for name, value in known.items():
        index = None if name == PAYLOAD else _index(sms, name, "known")
        if isinstance(value, Mapping):
            keys = {"mass", "inertia"} <= set(value) <= {"mass", "inertia", "com"}
            if not keys:
                text = "must have the keys mass and inertia, and optionally com"
                raise InvalidValue(f"known.{name}", dict(value), f"{text}; for the mass alone give a number")
            body = value["mass"], value["inertia"], value.get("com", (0.0, 0.0, 0.0))
            mass, tensor, com = rigid_body(f"known.{name}", *body)
            value = pin.Inertia(mass, com, tensor)
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
    """Return the bodies named in `unknown`, with their priors.

    The prior deviations of mass, first moments and inertias are `spread` times m, m r and m r^2, with the
    body's mass m and its radius of gyration r about the origin of its frame. For a payload without a prior,
    `spread` is not used; m is the mass of the robot, and r is the base's radius of gyration about its centre
    of mass.
    """
    if isinstance(unknown, str) or not isinstance(unknown, Sequence) or not unknown:
        example = "a list of names such as ['base'], ['base', 'payload'] or link names"
        raise InvalidValue("unknown", unknown, f"must be {example}")
    spread = positive("spread", spread)
    bodies = [_unknown(known, name, spread) for name in unknown]
    if strangers := [name for name in known.masses if name not in unknown]:
        text = f"has the mass of '{strangers[0]}', which is not among the unknown bodies; to change the model"
        raise InvalidValue("known", known.masses, f"{text}, give mass and inertia (pinocchio.Inertia)")
    if known.payload is not None and PAYLOAD not in unknown:
        text = "has an inertia of the payload, which is not among the unknown bodies; add a known payload"
        raise InvalidValue("known", known.payload, f"{text} to the robot with sms.with_inertias")
    indices = [body.index for body in bodies]
    if len(set(indices)) < len(indices):
        text = "must name each body once; a payload cannot be distinguished from the link that carries it"
        raise InvalidValue("unknown", list(unknown), text)
    return bodies


def _unknown(known: Known, name: str, spread: float) -> UnknownBody:
    sms, mass, added = known.sms, known.masses.get(name), name == PAYLOAD
    index = sms.tip_joint - 1 if added else _index(sms, name, "unknown")
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
            text = "names a body without mass in the model; give its prior mass and inertia with known="
            raise InvalidValue("unknown", name, text)
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
    """Return the index (see `UnknownBody`) of the body that a link, joint or "base" names."""
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
