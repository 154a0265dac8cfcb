"""The comparison of prior, estimated and true bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError
from ffsms_pin.identification.identifier import Identifier
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.regressors import PER_BODY

_NOTHING = 1e-6  # share of the robot's mass below which a body is treated as massless


def compared(identifier: Identifier, plant: SpaceManipulator) -> dict[str, Any]:
    """Return prior ("believed"), estimated ("learnt") and true mass properties of the unknown bodies.

    `plant` is the true robot. The properties are the mass [kg], the centre of mass in the link's frame (3,)
    [m], and the inertia about the centre of mass (3, 3) [kg m^2]; the last two are None for a massless body.
    A true payload is the difference between the plant's link and the model's link. If the estimate is
    inconsistent, as after an external force, it is None and the note has the reason.
    """
    note, estimate = "", None
    try:
        estimate = identifier.found
        note = estimate.note
    except FfsmsError as error:
        note = f"the estimate is physically inconsistent, probably because of an external force: {error}"
    model, true = (sms.inertial_parameters.reshape(-1, PER_BODY) for sms in (identifier.sms, plant))
    least = _NOTHING * float(true[:, 0].sum())
    numbers: dict[str, Any] = {"uncertainty_left": identifier.uncertainty(), "note": note, "bodies": {}}
    for body in identifier.bodies:
        real = true[body.index] - (model[body.index] if body.added else 0.0)
        believed = body.believed if body.believed[0] > least else np.zeros(PER_BODY)
        learnt = None if estimate is None else estimate[body.name]
        numbers["bodies"][body.name] = {
            "believed": _numbers(believed, least),
            "learnt": None if learnt is None else _numbers(learnt.parameters, least),
            "mass_deviation_kg": None if learnt is None else float(learnt.deviation[0]),
            "true": _numbers(real, least),
        }
    return numbers


def _numbers(parameters: FloatArray, least: float) -> dict[str, Any]:
    mass = float(parameters[0])
    if mass < least:
        return {"mass_kg": mass, "com_m": None, "inertia_kg_m2": None}
    body = pin.Inertia.FromDynamicParameters(parameters)
    return {"mass_kg": mass, "com_m": body.lever.tolist(), "inertia_kg_m2": body.inertia.tolist()}
