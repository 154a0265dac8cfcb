"""Measure the momentum error in an hour with moving wheels, and the error of an attitude held by wheels.

Run `python benchmarks/wheels.py --targets 20` for the moves, and `python benchmarks/wheels.py --hour
[--integrator NAME]` for the hour. The moves are those of `motions.py`; four wheels hold the attitude. Plans
include the held attitude (`opt.plan(..., mode="rotation-floating")`), or are for a floating base and ignore
the wheels.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import BaseCommand, BaseView, ComputedTorque, Coordinated

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
RPM = 2.0 * np.pi / 60.0
# docs/bases-that-act.md has the sources of the numbers.
SMALL = ffsms.ReactionWheels(PYRAMID, 0.001364, 0.1, 0.001364 * 7000.0 * RPM)
LARGE = ffsms.ReactionWheels(PYRAMID, 12.0 / (6000.0 * RPM), 0.2, 12.0)

LONG = ((300.0, 1e-2), (300.0, 5e-3), (300.0, 2e-3), (3600.0, 1e-2), (3600.0, 2.5e-3))  # duration, step [s]
# Modes of the plans, and durations [s] of the moves. A floating plan ignores the wheels.
MODES = {"floating": [12.0, 24.0, 36.0], "rotation-floating": [12.0]}
ARMS = ("satellite_ur5", "satellite_panda", "satellite_xarm7")


class Wave:
    """Wheel torques that vary as sines."""

    def command(self, view: BaseView) -> BaseCommand:
        """Return four sines."""
        return BaseCommand(0.05 * np.sin(3.0 * view.t + np.arange(4.0)))


class Swinging:
    """A reference of joints that swing as sines."""

    def __init__(self, sms: ffsms.SpaceManipulator, duration: float) -> None:
        self.q, self.duration, self.target = sms.configuration(np.zeros(sms.n))[None], duration, np.zeros(3)
        self._size = 0.3 * np.ones(sms.n)

    def sample(self, t: float) -> tuple[Any, Any, Any]:
        """Return a sine for every joint."""
        s, c = np.sin(0.5 * t), np.cos(0.5 * t)
        return self._size * s, 0.5 * self._size * c, -0.25 * self._size * s


def an_hour(seconds: float, integrator: str, dt: float) -> dict[str, float]:
    """Return the relative error of the total momentum over a run [s] with steps dt [s]."""
    sms = ffsms.load("planar_3r").with_actuators(wheels=SMALL)
    start, began = [0.4, -0.3, 0.2, 0.5], time.process_time()
    run = ffsms.simulate(
        sms,
        Swinging(sms, seconds),
        ComputedTorque(sms, 4.0, 4.0),
        dt,
        base_controller=Wave(),
        conditions=ffsms.Conditions(wheel_momentum=start, integrator=integrator),
    )
    size = float(np.linalg.norm(run.momentum[0]))
    return {
        "seconds": seconds,
        "dt": dt,
        "momentum_error": float(np.abs(run.momentum - run.momentum[0]).max()) / size,
        "cpu_s": time.process_time() - began,
    }


def held(sms: ffsms.SpaceManipulator, plan: Any) -> dict[str, Any]:
    """Return the largest attitude error [deg], wheel torque [N m] and momentum [N m s] on a plan."""
    law = Coordinated(sms)
    run = ffsms.simulate(sms, plan, law, 2e-3, base_controller=law)
    start = pin.Quaternion(run.q[0, 3:7])
    turns = [start.angularDistance(pin.Quaternion(row)) for row in run.q[::5, 3:7]]
    return {
        "attitude_deg": float(np.degrees(max(turns))),
        "torque": float(np.abs(run.wheel_torque).max()),
        "momentum": float(np.abs(run.wheel_momentum).max()),
        "predicted_momentum": float(np.abs(plan.wheel_momentum).max()),
        "end_error_m": float(run.position_error[-1]),
        "floating_deg": float(np.degrees(plan.base_rotation.max())),
        "note": run.note,
    }


def moves(
    name: str, wheels: ffsms.ReactionWheels, count: int, durations: list[float], mode: str
) -> list[dict[str, Any]]:
    """Return the moves of `motions.py` with seed 1, each planned for several durations."""
    sms, rng = ffsms.load(name).with_actuators(wheels=wheels), np.random.default_rng(1)
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    found: list[dict[str, Any]] = []
    while len(found) < count * len(durations):
        q0 = sms.configuration(0.5 * (low + high) + 0.25 * (high - low) * rng.uniform(-1.0, 1.0, sms.n))
        way = rng.normal(size=3)
        way *= rng.uniform(0.1, 0.5) / np.linalg.norm(way)
        target = sms.at(q0).end_effector_pose.translation + way
        if not opt.plan(sms, q0, target, 12.0, 0.02, method="resolved-rate").reached:
            continue
        for duration in durations:
            plan = opt.plan(sms, q0, target, duration, 0.02, mode=mode)
            found.append({"duration": duration, "reached": plan.reached, **held(sms, plan)})
    return found


def line(label: str, duration: float, rows: list[dict[str, Any]]) -> tuple[str, ...]:
    """Return a line of the table for the moves of one duration."""
    errors = np.array([row["attitude_deg"] for row in rows])
    off = [
        abs(row["momentum"] / row["predicted_momentum"] - 1.0) for row in rows if row["predicted_momentum"]
    ]
    return (
        label,
        f"{duration:g} s",
        f"{sum(row['reached'] for row in rows)} of {len(rows)}",
        f"{int((errors < 0.1).sum())}",
        f"{np.median(errors):.1g}, {errors.max():.1g} deg",
        f"{sum('torque' in row['note'] for row in rows)}",
        f"{max(row['momentum'] for row in rows):.2g} N m s",
        f"{100.0 * max(off):.1g} %" if off else "",
    )


def hour(integrator: str) -> str:
    """Return a table of the momentum's error over long runs."""
    runs = [an_hour(seconds, integrator, dt) for seconds, dt in LONG]
    lines = [
        (
            f"{run['seconds']:g} s",
            f"{1e3 * run['dt']:g} ms",
            f"{run['momentum_error']:.1e}",
            f"{run['cpu_s']:.0f} s",
        )
        for run in runs
    ]
    return markdown(("flight [s]", "step [ms]", "relative change of the momentum", "CPU time [s]"), lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="with four large wheels")
    parser.add_argument("--hour", action="store_true", help="measure long flights instead")
    parser.add_argument("--integrator", default="rk4", help="of the long flights")
    arguments = parser.parse_args()
    if arguments.hour:
        print(hour(arguments.integrator))
        return
    case = ffsms.scenario("case-2")
    small, lines = case.load().with_actuators(wheels=SMALL), []
    for mode, durations in MODES.items():
        plan = opt.solve(replace(case.problem(small), mode=mode))
        found = [{"reached": plan.reached, **held(small, plan)}]
        lines.append(line(f"Case 2, planned {mode}", plan.duration, found))
        for name in arguments.arms:
            rows = moves(name, LARGE, arguments.targets, durations, mode)
            for duration in durations:
                own = [row for row in rows if row["duration"] == duration]
                lines.append(line(f"`{name}`, planned {mode}", duration, own))
    head = (
        "plans",
        "duration",
        "reached",
        "attitude within 0.1 deg",
        "attitude error, median, max",
        "at a torque limit",
    )
    print(markdown((*head, "largest momentum", "difference from the plan"), lines))


if __name__ == "__main__":
    main()
