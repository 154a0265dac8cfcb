"""Compare states and control steps with the least library calls that they need: Markdown tables.

Run from the repository's root: python benchmarks/state_floor.py
The library and the floor (the sum of these calls) process the same states in the same run, alternately. The
shortest time of each is used, because other load on the machine affects it least. Compare ratios. The floor
calls LAPACK directly; with NumPy's solve and SVD it would be higher (`numpy_us`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypedDict

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.simulation.integrators import rk4_step

ROBOTS = ("planar_3r", "satellite_panda")
# All public quantities of a state.
QUANTITIES = (
    *("H", "H_b", "H_bm", "H_m", "C_b", "C_m", "H_q", "C_q", "J_b", "J_m", "J_star", "C_bm", "C_be"),
    *("base_pose", "base_twist", "end_effector_pose", "com", "momentum", "kinetic_energy"),
)
STATES, TURNS, DT = 20, 300, 1e-3
_WORLD, _AXES = pin.Convention.WORLD, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class Floor(TypedDict):
    """The times of an operation in microseconds, each the shortest of many repetitions.

    `parts` are the calls of the floor by name and `floor_us` their sum; `least_us` is the time of the
    library, and `ratio` its multiple of the floor. `numpy_us` is the floor with `numpy.linalg` in place of
    LAPACK.
    """

    what: str
    robot: str
    least_us: float
    floor_us: float
    numpy_us: float
    ratio: float
    parts: dict[str, float]


def run(turns: int = TURNS) -> dict[str, list[Floor]]:
    """Measure states with all quantities, states with the coupling only, and control steps."""
    out: dict[str, list[Floor]] = {"state": [], "coupling": [], "control": []}
    for robot in ROBOTS:
        sms = ffsms.load(robot)
        out["state"].append(state_floor(sms, robot, turns))
        out["coupling"].append(coupling_floor(sms, robot, turns))
        out["control"].append(control_floor(sms, robot, turns))
    return out


def state_floor(sms: ffsms.SpaceManipulator, robot: str, turns: int) -> Floor:
    """Measure `sms.at(q, v)` with all quantities."""

    def whole(q: FloatArray, v: FloatArray) -> None:
        state = sms.at(q, v)
        coupling = state.coupling
        _ = coupling.U, coupling.sigma, coupling.V, coupling.entropy
        for name in QUANTITIES:
            getattr(state, name)

    return _measured("every quantity", robot, sms, whole, _state_parts(sms), turns)


def coupling_floor(sms: ffsms.SpaceManipulator, robot: str, turns: int) -> Floor:
    """Measure `sms.at(q).coupling` alone."""
    parts = {name: part for name, part in _state_parts(sms).items() if name in ("crba", "6x6 solve", "SVD")}

    def coupling(q: FloatArray, v: FloatArray) -> None:
        _ = sms.at(q).coupling.entropy

    return _measured("coupling alone", robot, sms, coupling, parts, turns)


def control_floor(sms: ffsms.SpaceManipulator, robot: str, turns: int) -> Floor:
    """Measure a torque of `SlidingModeController` and a Runge-Kutta step of the plant under it."""
    model, data = sms.model, sms.model.createData()
    controller = ffsms.SlidingModeController(sms)
    wanted = np.zeros(sms.n)
    force = np.zeros(sms.nv)

    def step(q: FloatArray, v: FloatArray) -> None:
        force[6:] = controller.torque(q, v, wanted, wanted, wanted)
        rk4_step(model, data, q, v, force, DT)

    parts = _state_parts(sms)
    return _measured(
        "control step",
        robot,
        sms,
        step,
        {
            "crba": parts["crba"],
            "nonLinearEffects": parts["nonLinearEffects"],
            "Schur solve": parts["6x6 solve"],
            "4 aba": lambda q, v: [pin.aba(model, data, q, v, force) for _ in range(4)],
            "4 integrate": lambda q, v: [pin.integrate(model, q, v) for _ in range(4)],
        },
        turns,
    )


Part = Callable[[FloatArray, FloatArray], Any]


def _state_parts(sms: ffsms.SpaceManipulator) -> dict[str, Part]:
    model, data, frame = sms.model, sms.model.createData(), sms.frame_id
    M = pin.crba(model, data, sms.configuration(np.full(sms.n, 0.3)), _WORLD).copy()
    M_b, M_bm = np.asfortranarray(M[:6, :6]), np.asfortranarray(M[:6, 6:])
    C_bm = np.linalg.solve(M_b, M_bm)
    return {
        "crba": lambda q, v: pin.crba(model, data, q, _WORLD),
        "nonLinearEffects": lambda q, v: pin.nonLinearEffects(model, data, q, v),
        "Jacobians": lambda q, v: pin.computeJointJacobians(model, data, q),
        "frame Jacobian": lambda q, v: pin.getFrameJacobian(model, data, frame, _AXES),
        "6x6 solve": lambda q, v: lapack.dposv(M_b, M_bm),
        "SVD": lambda q, v: lapack.dgesdd(C_bm),
    }


_NUMPY = {"6x6 solve": "numpy solve", "Schur solve": "numpy solve", "SVD": "numpy SVD"}


def _numpy_parts(sms: ffsms.SpaceManipulator) -> dict[str, Part]:
    state = sms.at(sms.configuration(np.full(sms.n, 0.3)))
    H_b, H_bm, C_bm = (np.array(array) for array in (state.H_b, state.H_bm, state.C_bm))
    return {
        "numpy solve": lambda q, v: np.linalg.solve(H_b, H_bm),
        "numpy SVD": lambda q, v: np.linalg.svd(C_bm),
    }


def _states(sms: ffsms.SpaceManipulator) -> list[tuple[FloatArray, FloatArray]]:
    rng = np.random.default_rng(0)
    return [
        (sms.configuration(rng.uniform(-1.0, 1.0, sms.n)), rng.uniform(-0.5, 0.5, sms.nv))
        for _ in range(STATES)
    ]


def _measured(
    what: str, robot: str, sms: ffsms.SpaceManipulator, ours: Part, parts: dict[str, Part], turns: int
) -> Floor:
    states = _states(sms)
    plain = _numpy_parts(sms)
    calls = {"ours": ours, **parts, **plain}
    least = dict.fromkeys(calls, np.inf)
    for _ in range(turns):
        for name, call in calls.items():
            begin = time.perf_counter()
            for q, v in states:
                call(q, v)
            least[name] = min(least[name], 1e6 * (time.perf_counter() - begin) / STATES)
    floor = sum(least[name] for name in parts)
    return {
        "what": what,
        "robot": robot,
        "least_us": least["ours"],
        "floor_us": floor,
        "numpy_us": sum(least[_NUMPY.get(name, name)] for name in parts),
        "ratio": least["ours"] / floor,
        "parts": {name: least[name] for name in parts},
    }


# Quantities that are computed together when the first is read.
GROUPS = (
    ("C_bm", "N and C_bm"),
    ("H_q", "H_q"),
    ("J_star", "J*"),
    ("H", "H and its blocks"),
    ("J_b", "J_b and J_m"),
    ("C_q", "C_q"),
    ("base_twist", "base twist"),
    ("C_b", "C_b and C_m"),
    ("com", "centre of mass, momentum, energy"),
    ("base_pose", "base pose"),
    ("end_effector_pose", "end effector's pose"),
    ("C_be", "C_be"),
    ("coupling", "SVD and entropy"),
)


def where(robot: str, turns: int = TURNS) -> dict[str, float]:
    """Return the times [us] of the parts of a state, and of torque and integration in a control step."""
    sms = ffsms.load(robot)
    states, now = _states(sms), time.perf_counter_ns
    controller, data = ffsms.SlidingModeController(sms), sms.model.createData()
    wanted, force = np.zeros(sms.n), np.zeros(sms.nv)
    least: dict[str, float] = {}
    for _ in range(turns):
        taken = dict.fromkeys(("clock", "at(q, v)", *(name for _, name in GROUPS), "torque", "rk4_step"), 0)
        for q, v in states:
            a = now()
            b = now()
            taken["clock"] += b - a
            a = now()
            state = sms.at(q, v)
            taken["at(q, v)"] += now() - a
            for quantity, name in GROUPS:
                a = now()
                getattr(state, quantity)
                taken[name] += now() - a
            a = now()
            force[6:] = controller.torque(q, v, wanted, wanted, wanted)
            b = now()
            rk4_step(sms.model, data, q, v, force, DT)
            taken["torque"] += b - a
            taken["rk4_step"] += now() - b
        for name, value in taken.items():
            least[name] = min(least.get(name, np.inf), 1e-3 * value / STATES)
    clock = least.pop("clock")
    return {name: value - clock for name, value in least.items()}


def main() -> None:
    """Print the tables."""
    print(
        "| operation | robot | time [us] | floor [us] | floor with numpy.linalg [us] | ratio "
        "| calls of the floor |"
    )
    print("|---|---|---|---|---|---|---|")
    for rows in run().values():
        for row in rows:
            parts = ", ".join(f"{name} {value:.1f}" for name, value in row["parts"].items())
            print(
                f"| {row['what']} | {row['robot']} | {row['least_us']:.1f} | {row['floor_us']:.1f} | "
                f"{row['numpy_us']:.1f} | {row['ratio']:.2f} | {parts} |",
                flush=True,
            )
    found = [where(robot) for robot in ROBOTS]
    print(f"\n| part [us] | {' | '.join(ROBOTS)} |\n|---|{'---|' * len(ROBOTS)}")
    for name in found[0]:
        print(f"| {name} | {' | '.join(f'{one[name]:.1f}' for one in found)} |")


if __name__ == "__main__":
    main()
