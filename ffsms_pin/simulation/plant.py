"""Plants whose masses, inertias and centres of mass differ from those of the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import dimensions, one_each, positive, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.options import PerJointPositive, Positive, Share, Shifts, Unit, Vector3
from ffsms_pin.robot import SpaceManipulator


@dataclass(frozen=True, eq=False)
class InertialError:
    """The differences of a plant's inertial parameters from the model's.

    Without an inertia factor, a body's inertia about its centre of mass scales with its mass, as if its
    density changed.

    Raises
    ------
    InvalidValue
        A factor is not above zero, or an array has a wrong shape; raised when a plant is made.
    """

    arm_mass: Annotated[PerJointPositive, Unit()] = 1.0
    """The factor on the masses of the arm's bodies; per joint."""
    base_mass: Annotated[Positive, Unit()] = 1.0
    """The factor on the mass of the base."""
    arm_inertia: Annotated[PerJointPositive | None, Unit("", "arm_mass")] = None
    """The factor on the inertias of the arm's bodies about their centres of mass; per joint."""
    base_inertia: Annotated[Positive | None, Unit("", "base_mass")] = None
    """The factor on the base's inertia about its centre of mass."""
    arm_com: Annotated[Shifts, Unit("m", "0")] = (0.0, 0.0, 0.0)
    """The shift of the arm's centres of mass in the axes of each body's joint: 3 numbers, or 3 per joint."""
    base_com: Annotated[Vector3, Unit("m", "0")] = (0.0, 0.0, 0.0)
    """The shift of the base's centre of mass in the root frame."""


def perturb(sms: SpaceManipulator, error: InertialError | None = None, **errors: Any) -> SpaceManipulator:
    """Return the same robot with other inertial parameters; shapes and limits stay.

    Parameters
    ----------
    sms : SpaceManipulator
        The nominal robot.
    error : InertialError, optional
        The differences.
    **errors
        The fields of `InertialError` instead of `error`, such as ``perturb(sms, arm_mass=1.2)``.

    Returns
    -------
    SpaceManipulator

    Raises
    ------
    InvalidValue
        A factor is not above zero, an array has a wrong shape, or both `error` and keywords are given.
    TypeError
        A keyword is not a field of `InertialError`.
    """
    if error is None:
        error = InertialError(**errors)
    elif errors:
        raise InvalidValue("error", error, f"cannot be given together with {', '.join(errors)}")
    n = sms.n
    arm_mass = one_each("arm_mass", error.arm_mass, n)
    arm_inertia = arm_mass if error.arm_inertia is None else one_each("arm_inertia", error.arm_inertia, n)
    base_mass = positive("base_mass", error.base_mass)
    base_inertia = base_mass if error.base_inertia is None else positive("base_inertia", error.base_inertia)
    com = error.arm_com
    if dimensions("arm_com", com) < 2:
        com = [com] * n
    elif len(com) != n:
        raise InvalidValue("arm_com", com, f"must be one shift (3,) or one per joint ({n}, 3)")
    shifts = [vector("base_com", error.base_com, 3, "m"), *(vector("arm_com", row, 3, "m") for row in com)]
    masses, turning = [base_mass, *arm_mass.tolist()], [base_inertia, *arm_inertia.tolist()]
    bodies = zip(list(sms.model.inertias)[1:], masses, turning, shifts, strict=True)
    return sms.with_inertias(
        [pin.Inertia(m * body.mass, body.lever + shift, t * body.inertia) for body, m, t, shift in bodies]
    )


def random_plants(
    sms: SpaceManipulator,
    rng: np.random.Generator,
    count: int,
    arm_mass: Annotated[Share, Unit()] = 0.2,
    base_mass: Annotated[Share, Unit()] = 0.1,
    base_inertia: Annotated[Share, Unit()] = 0.1,
) -> Iterator[SpaceManipulator]:
    """Yield robots whose inertial parameters have relative errors, drawn uniformly up to the given bounds.

    Parameters
    ----------
    sms : SpaceManipulator
        The nominal robot.
    rng : numpy.random.Generator
        The generator of random numbers.
    count : int
        The number of robots.
    arm_mass : float
        The largest relative error of each arm body's mass and inertia, which have the same error.
    base_mass : float
        The largest relative error of the base's mass, which changes as fuel is burnt.
    base_inertia : float
        The largest relative error of the base's inertia.

    Yields
    ------
    SpaceManipulator

    Raises
    ------
    InvalidValue
        A relative error is not in [0, 1); raised when the first robot is drawn.
    """
    for name, share in (("arm_mass", arm_mass), ("base_mass", base_mass), ("base_inertia", base_inertia)):
        if not 0.0 <= share < 1.0:
            raise InvalidValue(name, share, "must be a share of at least 0 and below 1")
    for _ in range(count):
        yield perturb(
            sms,
            arm_mass=1.0 + arm_mass * rng.uniform(-1.0, 1.0, sms.n),
            base_mass=1.0 + base_mass * float(rng.uniform(-1.0, 1.0)),
            base_inertia=1.0 + base_inertia * float(rng.uniform(-1.0, 1.0)),
        )
