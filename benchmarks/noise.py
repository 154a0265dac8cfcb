"""Measure the final error with noisy, delayed sensors and random plants, and print a Markdown table.

Run from the repository's root: python benchmarks/noise.py [--plants 30] [--jobs 2] [--sensors raw]
Each plant is drawn at random: the masses of the arm's bodies +-30 %, the base's +-20 %, every centre of mass
shifted by 2 cm in any direction. The reference is updated at 100 Hz and re-planned every 0.1 s; computed
torque runs at 500 Hz. `SENSORS` has the data of the sensors. --sensors raw uses the measurements without an
estimator, --sensors perfect the true state.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from reaching import problem

from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan.correctable import Correctable
from ffsms_pin.processes import map_in_processes
from ffsms_pin.simulation import Conditions, Sensors, perturb, simulate

DURATION, HOLD, DT = 12.0, 2.0, 2e-3  # [s]
ARCSECOND = math.radians(1.0) / 3600.0
SENSORS = Sensors(
    joint_resolution=2.0 * math.pi / 2**17,  # 17-bit absolute encoders, as in industrial drives
    joint_noise=5e-5,  # [rad] one step of the encoders
    joint_rate_noise=1e-3,  # [rad/s] one step differentiated over 50 ms
    base_position_noise=1e-3,  # [m] camera or lidar at short range
    base_velocity_noise=1e-3,  # [m/s]
    base_attitude_noise=10.0 * ARCSECOND,  # star tracker
    base_rate_noise=1e-4,  # [rad/s] 20 arcsec/s: MEMS gyroscope of tactical grade
    base_latency=0.02,  # [s]
)
# Cases of benchmarks/reaching.py. The last target is at the edge of the workspace, for some plants
# beyond it, so compare its errors with those of perfect sensors.
ROWS = (("planar_3r", 1), ("satellite_panda", 1), ("planar_3r", 2))


class Run(NamedTuple):
    """The numbers of one run.

    The first four are errors in mm: at the deadline, its part in the directions that the arm can correct, its
    largest increase during the motion, and its largest value in the hold. The torque in the hold
    (root mean square, worst joint) is divided by the torque that noise alone causes in a robot at rest.
    """

    end: float
    correctable: float
    rise: float
    hold: float
    torque: float


def random_plant(sms: Any, rng: np.random.Generator) -> Any:
    """Draw a plant with other masses and centres of mass than the model."""
    shifts = rng.normal(size=(sms.n + 1, 3))
    shifts *= 0.02 / np.linalg.norm(shifts, axis=1, keepdims=True)
    return perturb(
        sms,
        arm_mass=1.0 + 0.3 * rng.uniform(-1.0, 1.0, sms.n),
        base_mass=1.0 + 0.2 * float(rng.uniform(-1.0, 1.0)),
        arm_com=shifts[1:],
        base_com=shifts[0],
    )


def own_share(sms: Any, law: Any, sensors: Sensors, q: Any) -> Any:
    """Return the deviations (n,) [N m] of the law's torques due to noise alone, for a robot at rest."""
    seen = replace(sensors, seed=sensors.seed + 1000).start(sms, DT, DURATION)
    joints, still = sms.layout.positions(q), np.zeros(sms.n)
    rest = np.zeros(sms.nv)
    taus = [law.torque(*seen(q, rest), joints, still, still) for _ in range(1000)]
    return np.std(taus, axis=0)


def run(shared: tuple[Any, ...], task: tuple[int, Any]) -> Run:
    """Run one plant."""
    sms, plan, kind = shared
    seed, plant = task
    law, sensors = ComputedTorque(sms, K_p=100.0, K_d=20.0), replace(SENSORS, seed=seed)
    limits = [opt.JointLimits(), opt.Clearance(0.01, "points"), opt.AlphaBox()]
    rest = opt.Problem(sms, plan.q[0], plan.target, DURATION, 0.01, limits=limits)
    reference = opt.Replanning(rest, HOLD, plan=plan)
    shown = None if kind == "perfect" else sensors
    estimator = False if kind == "raw" else None
    tracking = simulate(
        sms, reference, law, DT, plan.q[0], plant, conditions=Conditions(sensors=shown, estimator=estimator)
    )
    error = 1e3 * tracking.position_error
    arrival = round(DURATION / DT)
    q = tracking.q[arrival]
    _, left = Correctable(sms).goal(opt.Position(plan.target), q, 0.0)
    late = tracking.tau[arrival + round(0.5 / DT) :]
    share = own_share(sms, law, sensors, q)
    on_the_way = error[: arrival + 1]
    return Run(
        float(error[arrival]),
        math.sqrt(max(0.0, float(error[arrival]) ** 2 - (1e3 * left) ** 2)),
        float((on_the_way - np.minimum.accumulate(on_the_way)).max()),
        float(error[arrival:].max()),
        float((np.sqrt((late**2).mean(axis=0)) / share).max()),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--rows", type=int, nargs="*", default=(0, 1, 2), help="which rows")
    parser.add_argument("--sensors", choices=("estimated", "raw", "perfect"), default="estimated")
    parser.add_argument("--each", action="store_true", help="print every run")
    arguments = parser.parse_args()
    print(f"{arguments.plants} random plants, {DURATION:g} s and {HOLD:g} s of hold; all but torque in mm:\n")
    print(
        "| robot | case | within 2 mm | whole error within 2 mm | median | max "
        "| largest increase | hold | torque |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for row in arguments.rows:
        robot, case = ROWS[row]
        sms, q0, target = problem(robot, case)
        plan = opt.plan(sms, q0, target, DURATION)
        rng = np.random.default_rng(arguments.seed)
        tasks = [(i, random_plant(sms, rng)) for i in range(arguments.plants)]
        runs = map_in_processes(partial(run, (sms, plan, arguments.sensors)), tasks, arguments.jobs)
        if arguments.each:
            print(*(" ".join(f"{x:.3f}" for x in one) for one in runs), sep="\n")
        end, correctable, rise, hold, torque = np.array(runs).T
        print(
            f"| {robot} | {case} | {(correctable <= 2.0).sum()} of {len(runs)} | {(end <= 2.0).sum()} | "
            f"{np.median(correctable):.2g} | {correctable.max():.2g} | {rise.max():.2g} | {hold.max():.2g} | "
            f"{np.median(torque):.2g}, max {torque.max():.2g} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
