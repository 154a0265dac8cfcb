"""The result of an identification: estimated bodies, their covariance, and observable directions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.identification.bodies import PARAMETERS, UnknownBody
from ffsms_pin.identification.consistency import nearest_consistent
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.regressors import PER_BODY

if TYPE_CHECKING:
    from ffsms_pin.identification.identifier import Identifier

SHOWN = 0.5  # share of the prior deviation below which a direction is observed
_ROUNDING = 1e-14  # least variance, as a share of the prior variance
# A note warns of a wrong model if the unexplained share of the momentum exceeds _UNEXPLAINED, or, for given
# sensors, if the mean square of the weighted residuals exceeds _SUSPICIOUS. Arm masses with errors of 15 %
# cause a share of 0.04.
_UNEXPLAINED = 0.08
_SUSPICIOUS = 4.0


class Solution(NamedTuple):
    """The least-squares estimate, in units of the prior deviations.

    Attributes
    ----------
    x : ndarray, shape (k,)
        The difference between the estimated and the prior parameters.
    covariance : ndarray, shape (k, k)
        The covariance of `x`.
    residual : float
        The mean square of the weighted residuals of the momentum, about 1 or less if the noise is as stated.
        It is at least 0.5, and 1 if there are few equations.
    equations : int
        The number of equations from the measurements.
    unexplained : float
        The residuals in excess of the noise, as a share of the momentum of the unknown bodies.
    """

    x: FloatArray
    covariance: FloatArray
    residual: float
    equations: int
    unexplained: float


@dataclass(frozen=True, eq=False)
class BodyEstimate:
    """An estimated body, in the frame of its link.

    Attributes
    ----------
    name : str
    parameters : ndarray, shape (10,)
        [m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] about the link's origin [kg, kg m, kg m^2], in Pinocchio's
        order.
    covariance : ndarray, shape (10, 10)
        The covariance of the parameters.
    believed : ndarray, shape (10,)
        The prior parameters.
    """

    name: str
    parameters: FloatArray
    covariance: FloatArray
    believed: FloatArray

    @property
    def mass(self) -> float:
        """The mass [kg]."""
        return float(self.parameters[0])

    @property
    def com(self) -> FloatArray:
        """The centre of mass (3,) in the link's frame [m]."""
        return np.asarray(self.parameters[1:4] / self.parameters[0])

    @property
    def inertia(self) -> FloatArray:
        """The inertia (3, 3) about the centre of mass, in the link's axes [kg m^2]."""
        return np.array(self.inertial.inertia)

    @property
    def inertial(self) -> Any:
        """The body as a pinocchio.Inertia."""
        return pin.Inertia.FromDynamicParameters(self.parameters)

    @property
    def deviation(self) -> FloatArray:
        """The standard deviations (10,) of the parameters."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def __repr__(self) -> str:
        com = np.array2string(self.com, precision=4)
        principal = np.array2string(np.linalg.eigvalsh(self.inertia), precision=4)
        mass = f"{self.mass:.6g} kg (deviation {self.deviation[0]:.2g})"
        return f"BodyEstimate({self.name}: {mass}, com {com} m, principal inertias {principal} kg m^2)"


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction in the space of the unknown parameters, and its remaining uncertainty.

    Attributes
    ----------
    left : float
        The remaining share of the prior standard deviation: 1 for an unobservable direction.
    vector : dict of str to ndarray, shape (10,)
        The change of each body's parameters for a step of one prior standard deviation.
    words : str
        The parameters with the largest shares of the direction.
    """

    left: float
    vector: dict[str, FloatArray]
    words: str

    def __str__(self) -> str:
        return f"{self.words}: {100.0 * self.left:.2g} % of the prior deviation left"


@dataclass(frozen=True, eq=False)
class Identification(Mapping[str, BodyEstimate]):
    """The estimated bodies by name, and the robot with these bodies.

    Attributes
    ----------
    sms : SpaceManipulator
        The robot with the estimated inertias. `other.with_inertias(found)` sets them in another robot.
    bodies : dict of str to BodyEstimate
    covariance : ndarray, shape (10 (1 + n), 10 (1 + n))
        The covariance of the parameters of all bodies of the robot, zero for known bodies.
        `Trajectory.spread` uses it.
    directions : tuple of Direction
        All directions, the best-observed first.
    residual : float
        The mean square of the weighted residuals of the momentum, about 1 or less if the noise is as stated.
        It is at least 0.5, and 1 if there are few equations.
    equations : int
        The number of equations from the measurements.
    projected : bool
        True if the least-squares estimate was inconsistent, so that the nearest consistent estimate replaces
        it.
    note : str
        The unobserved parameters with reasons, and signs of a wrong model; may be empty.
    """

    sms: SpaceManipulator
    bodies: dict[str, BodyEstimate]
    covariance: FloatArray
    directions: tuple[Direction, ...]
    residual: float
    equations: int
    projected: bool
    note: str

    # Estimates are compared by identity, because comparing their arrays has no single truth value.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __getitem__(self, name: str) -> BodyEstimate:
        return self.bodies[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.bodies)

    def __len__(self) -> int:
        return len(self.bodies)

    @property
    def inertias(self) -> list[Any]:
        """The inertias of all bodies of the robot (pinocchio.Inertia), the base first."""
        return list(self.sms.model.inertias)[1:]

    @cached_property
    def observable(self) -> tuple[Direction, ...]:
        """The directions whose standard deviation is less than half of the prior deviation."""
        return tuple(direction for direction in self.directions if direction.left < SHOWN)

    @cached_property
    def unobservable(self) -> tuple[Direction, ...]:
        """The other directions, which keep at least half of the prior deviation."""
        return tuple(direction for direction in self.directions if direction.left >= SHOWN)

    def __str__(self) -> str:
        lines = [f"{len(self.observable)} of {len(self.directions)} directions observed"]
        lines += [repr(body) for body in self.bodies.values()]
        return "\n".join([*lines, *filter(None, [self.note])])

    __repr__ = __str__


def identification_of(identifier: Identifier, near: FloatArray | None = None) -> Identification:
    """Return the consistent estimate from an identifier's samples, with covariance and notes.

    `near` (b, 10) are consistent parameters near the estimate, at which the search begins.
    """
    bodies, solved = identifier.bodies, identifier.solution()
    free = np.array([body.free for body in bodies])
    scales = np.array([body.deviation for body in bodies])
    believed = np.array([body.believed for body in bodies])
    estimate = believed.copy()
    estimate[free] += scales[free] * solved.x
    squares, V = np.linalg.eigh(solved.covariance)
    left = np.sqrt(np.clip(squares, _ROUNDING, 1.0))  # at most the prior uncertainty
    information = (V / left**2) @ V.T / np.outer(scales[free], scales[free])
    sizes = _sizes(believed, scales)
    settled = nearest_consistent(estimate, information, sizes, free, near)
    covariance = np.zeros((believed.size, believed.size))
    chosen = np.flatnonzero(free.ravel())
    covariance[np.ix_(chosen, chosen)] = (V * left**2) @ V.T * np.outer(scales[free], scales[free])
    estimates = {}
    for k, body in enumerate(bodies):
        own = slice(PER_BODY * k, PER_BODY * (k + 1))
        estimates[body.name] = BodyEstimate(
            body.name, frozen(settled[k]), frozen(covariance[own, own].copy()), frozen(body.believed.copy())
        )
    directions = _directions(bodies, V, left, free, scales)
    return Identification(
        identifier.sms.with_inertias(_inertias(identifier.sms, bodies, settled)),
        estimates,
        frozen(_of_all(identifier.sms, bodies, covariance)),
        directions,
        solved.residual,
        solved.equations,
        settled is not estimate,
        "; ".join(filter(None, _notes(identifier, solved, V, left, free, scales, estimate))),
    )


def _sizes(believed: FloatArray, scales: FloatArray) -> FloatArray:
    """Return typical magnitudes (b, 10) of the unknown bodies' parameters."""
    masses = np.maximum(np.abs(believed[:, 0]), scales[:, 0])
    inertias = np.maximum(np.abs(believed[:, 4:]).max(axis=1), scales[:, 4:].max(axis=1))
    lengths = np.sqrt(inertias / masses)
    columns = [masses, *[masses * lengths] * 3, *[inertias] * 6]
    return np.array(columns).T


def _inertias(sms: SpaceManipulator, bodies: list[UnknownBody], parameters: FloatArray) -> list[Any]:
    inertias = list(sms.model.inertias)[1:]
    for body, numbers in zip(bodies, parameters, strict=True):
        own = pin.Inertia.FromDynamicParameters(numbers)
        inertias[body.index] = inertias[body.index] + own if body.added else own
    return inertias


def _of_all(sms: SpaceManipulator, bodies: list[UnknownBody], covariance: FloatArray) -> FloatArray:
    """Return the covariance (10 (1 + n), 10 (1 + n)) of all bodies, zero for known bodies."""
    size = PER_BODY * (1 + sms.n)
    whole = np.zeros((size, size))
    columns = np.concatenate([np.arange(PER_BODY) + PER_BODY * body.index for body in bodies])
    whole[np.ix_(columns, columns)] = covariance
    return whole


def _directions(
    bodies: list[UnknownBody], V: FloatArray, left: FloatArray, free: Any, scales: FloatArray
) -> tuple[Direction, ...]:
    """Return the eigenvectors `V` (k, k) of the covariance as directions, the best-observed first."""
    directions = []
    for i in np.argsort(left):
        numbers = np.zeros(free.shape)
        numbers[free] = V[:, i]
        largest = np.argsort(-np.abs(numbers), axis=None)[:3]
        parts = [divmod(int(j), PER_BODY) for j in largest if abs(numbers.flat[j]) > 0.3]
        names = ", ".join(f"{PARAMETERS[p]} of {bodies[b].name}" for b, p in parts)
        names = f"mostly {names}" if len(parts) < 3 else f"a combination of {names}"
        vector = {body.name: frozen(row) for body, row in zip(bodies, numbers * scales, strict=True)}
        directions.append(Direction(float(left[i]), vector, names or "a combination of many parameters"))
    return tuple(directions)


def _notes(
    identifier: Identifier,
    solved: Solution,
    V: FloatArray,
    left: FloatArray,
    free: Any,
    scales: FloatArray,
    estimate: FloatArray,
) -> Iterator[str]:
    """Yield sentences about unobserved parameters, and about signs of a wrong model."""
    bodies = identifier.bodies
    hidden = V[:, left >= SHOWN]
    if solved.residual > _SUSPICIOUS and identifier.noise.stated:
        yield (
            f"the residuals are {math.sqrt(solved.residual):.2g} times the sensors' noise,"
            " so other bodies differ from the model, or an external force acts"
        )
    if solved.unexplained > _UNEXPLAINED:
        more = ", and whether the total momentum is zero (at_rest)" if identifier.at_rest else ""
        yield (
            f"no values of the parameters explain {100.0 * solved.unexplained:.2g} % of the unknown bodies'"
            " momentum: check order, signs, units and delays of the measurements, and the masses of other"
            f" bodies{more}"
        )
    if not hidden.size:
        return
    if hidden.shape[1] == len(left):
        yield "the unknown bodies are not observable, because the joints hardly move"
        return
    whole = (estimate[free] / scales[free]) if not np.any(~free) else np.zeros(len(left))
    if (length := float(np.linalg.norm(whole))) > 0.0:
        share = float(np.linalg.norm(hidden.T @ whole)) / length
        if share > 0.99:
            yield (
                "the motion determines only ratios of masses and inertias, not their common scale, because"
                " the total momentum is constant: add a known mass (known={name: mass}) or torques"
            )
    alone = np.sqrt(np.einsum("ik,k,ik->i", V, left**2, V))
    names = [(k, p) for k, p in zip(*np.nonzero(free), strict=True)]
    lacking: dict[str, list[str]] = {}
    for (k, p), deviation in zip(names, alone, strict=True):
        if deviation >= SHOWN:
            lacking.setdefault(bodies[k].name, []).append(PARAMETERS[p])
    listed = "; ".join(f"{', '.join(parameters)} of {name}" for name, parameters in lacking.items())
    count = hidden.shape[1]
    yield (
        f"{count} of {len(left)} directions are not observed and keep their prior values"
        + (f", which affects {listed}" if listed else "")
    )
