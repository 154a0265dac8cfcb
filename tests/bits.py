"""What a fresh process comes to, as a digest a result; run by test_same_bits.py with numbers of BLAS threads.

    python bits.py JOBS FOLDER [without]

JOBS 0 calls `plan` and `simulate` themselves. `without` leaves out the limit to one BLAS thread.
"""

from __future__ import annotations

import hashlib
import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from scenario_files import QUICK, write

import ffsms_pin as ffsms
from ffsms_pin import opt, threads
from ffsms_pin.scenarios import robustness, scenario
from ffsms_pin.simulation import perturb, simulate_many

PLANS = 4
# As soon as there is a plan it is taken, which makes it a quick one.
PROBLEM: dict[str, Any] = {"duration": 2.0, "dt": 0.05, "collision": "points", "time_limit": 1e-9}
STUDY = QUICK.replace("dt = 0.05", "dt = 0.05\ntime_limit = 1e-9").replace("dt = 0.004", "dt = 0.02")


def digest(*results: Any) -> str:
    """Of every array in some results."""
    sha = hashlib.sha256()
    for result in results:
        for field in fields(result):
            value = getattr(result, field.name)
            if isinstance(value, np.ndarray):
                sha.update(value.tobytes())
    return sha.hexdigest()[:16]


def tasks(sms: ffsms.SpaceManipulator) -> tuple[list[Any], list[Any]]:
    """Starts and targets of plans."""
    rng = np.random.default_rng(5)
    middle = np.array([0.0, -0.4, 0.0, -1.8, 0.0, 1.5, 0.7])
    starts = [sms.configuration(middle + rng.uniform(-0.3, 0.3, 7)) for _ in range(PLANS)]
    targets = [sms.at(q0).end_effector_pose.translation + rng.uniform(-0.3, 0.3, 3) for q0 in starts]
    return starts, targets


def digests(jobs: int, folder: Path) -> dict[str, Any]:
    """Of plans, closed loops and a study, over so many processes."""
    sms = ffsms.load("satellite_panda")
    starts, targets = tasks(sms)
    if jobs == 0:
        plans = [opt.plan(sms, q0, target, **PROBLEM) for q0, target in zip(starts, targets, strict=True)]
    else:
        plans = opt.plan_many(sms, starts, targets, jobs=jobs, **PROBLEM)
    found: dict[str, Any] = {"plans": [digest(plan) for plan in plans]}

    heavier, law = perturb(sms, arm_mass=1.2), ffsms.SlidingModeController(sms)
    limits = [opt.JointLimits(), opt.Clearance(collision="points")]
    problem = opt.Problem(sms, starts[0], targets[0], 2.0, 0.05, limits=limits)
    references: list[Any] = [plans[1], opt.Replanning(problem, plan=plans[0])]
    if jobs == 0:
        runs = [
            ffsms.simulate(sms, reference, law, dt=0.02, q0=q0, plant=heavier)
            for reference, q0 in zip(references, (starts[1], starts[0]), strict=True)
        ]
    else:
        q0 = np.array([starts[1], starts[0]])
        runs = simulate_many(sms, references, law, dt=0.02, q0=q0, plant=heavier, jobs=jobs)
    found["runs"] = [digest(run) for run in runs]

    planner = opt.StepPlanner(sms, dt=0.05, collision="points")
    rates, steps = np.zeros(7), hashlib.sha256()
    for k in range(20):
        rates = planner.step(starts[0], rates, targets[0], 2.0 - 0.05 * k).joint_rates
        steps.update(rates.tobytes() + sms.at(starts[0], np.append(np.ones(6), rates)).coupling.V.tobytes())
    found["steps"] = steps.hexdigest()[:16]

    study = robustness(scenario(write(folder, STUDY)), plants=2, jobs=max(jobs, 1))
    errors = [study.distance[name].tobytes() for name in sorted(study.distance)]
    found["study"] = hashlib.sha256(b"".join(errors)).hexdigest()[:16]
    return found


class _Unlimited:
    """In place of the limit: nothing."""

    def __enter__(self) -> None:
        """Do nothing."""

    def __exit__(self, *_: object) -> None:
        """Likewise."""


if __name__ == "__main__":
    if sys.argv[3:] == ["without"]:
        threads._limit = _Unlimited()  # type: ignore[assignment]
        sms = ffsms.load("satellite_panda")
        pairs = zip(*tasks(sms), strict=True)
        answer: dict[str, Any] = {"plans": [digest(opt.plan(sms, *pair, **PROBLEM)) for pair in pairs]}
    else:
        answer = digests(int(sys.argv[1]), Path(sys.argv[2]))
    sys.stdout.write(json.dumps(answer))
