"""Measure tracking errors with and without an identification motion, and errors of identified parameters.

Run from the repository's root:
    python benchmarks/identification.py [ROW ...] [--count 20] [--resume FILE]
The rows are
    planar, panda   errors of all masses, inertias and centres of mass by up to 15 %: an identification motion
                    of 10 s with the sensors below, then a motion of 12 s (10 s for `panda`), planned once
    payload         an unknown body of 10 kg at the tip of `satellite_panda`, re-planned with and without
                    identification
    client          captured clients of 50 to 200 kg at 0.5 to 3 deg/s, with errors of up to 15 % in the
                    assumed mass and inertia: an identification motion of 8 s after the braking
    base            base inertia from a recording of MuJoCo, with the sensors below
    intervals       95 % intervals of the base's parameters over seeds of the noise
    time            the CPU time of one update of `Identifier`
Sensors, at 100 Hz: gyros with an angle random walk of 0.0035 deg/sqrt(h) (Honeywell GG1320AN, data sheet),
which is 1e-5 rad/s per sample; encoders of 19 bit, whose differences give rates to 5e-4 rad/s; the base's
velocity to 1 mm/s. With `--resume` each run is a line of that file. Runs in the file are not repeated, but
are included in the table. `--count` is the number of plants. The rows payload, base and client have a quarter
of this number of runs, the row of the intervals two and a half times this number.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import capture, control, export, identification, opt, simulation
from ffsms_pin.errors import FfsmsError
from ffsms_pin.robot.base_motion import straight_end
from ffsms_pin.system.regressors import pseudo_inertia

OFF = 0.15
STEP = 0.01  # [s] period of the sensors
CLASS = simulation.Sensors(
    base_rate_noise=1e-5,
    base_velocity_noise=1e-3,
    joint_resolution=2.0 * np.pi / 2**19,
    joint_rate_noise=5e-4,
)
WITHIN = 2e-3  # [m]
# Noise of the camera that measures a client before the capture.
EXACT = capture.Camera(position_noise=1e-4, attitude_noise=1e-4, velocity_noise=1e-5, rate_noise=1e-5)


def case(name: str) -> tuple[ffsms.SpaceManipulator, Any, Any, float]:
    """Return a robot, its start, its target and the duration of the plan."""
    if name == "planar":
        sms = ffsms.load("planar_3r")
        return sms, sms.configuration(np.radians([1.0, 1.0, 1.0])), [0.45, 0.65, 0.0], 12.0
    sms = ffsms.load("satellite_panda")
    q0 = sms.home()
    return sms, q0, sms.at(q0).end_effector_pose.translation + np.array([0.15, -0.2, 0.1]), 10.0


def wrong(sms: ffsms.SpaceManipulator, seed: int) -> ffsms.SpaceManipulator:
    """Return a plant with relative errors of all masses, inertias and centres of mass by up to `OFF`."""
    rng = np.random.default_rng(seed)
    bodies = []
    for body in list(sms.model.inertias)[1:]:
        m, turn, shift = 1.0 + OFF * rng.uniform(-1.0, 1.0, 3)
        lever = body.lever * (shift if np.any(body.lever) else 1.0)
        bodies.append(pin.Inertia(m * body.mass, lever, turn * body.inertia))
    return sms.with_inertias(bodies)


def measured(sms: ffsms.SpaceManipulator, t: Any, q: Any, v: Any, seed: int) -> Any:
    """Return (t, q, v) as measured by the sensors, at their rate."""
    rows = slice(None, None, max(1, round(STEP / float(t[1] - t[0]))))
    shown = simulation.Sensors(**{**vars(CLASS), "seed": seed})
    measure = shown.start(sms, STEP, float(t[-1]) + 1.0)
    pairs = [measure(a, b) for a, b in zip(q[rows], v[rows], strict=True)]
    return t[rows], np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])


def flown(sms: ffsms.SpaceManipulator, reference: Any, plant: ffsms.SpaceManipulator, q0: Any) -> Any:
    """Return the recording of a plant under computed torque with the nominal model."""
    return simulation.simulate(sms, reference, control.ComputedTorque(sms), dt=STEP, q0=q0, plant=plant)


@cache
def taught(name: str) -> tuple[Any, Any]:
    """Return the identification motion of all bodies, and the plan with the nominal robot."""
    sms, q0, target, duration = case(name)
    unknown = ["base", *sms.joint_names]
    return (
        identification.exciting_motion(sms, q0, 10.0, unknown=unknown, spread=OFF),
        opt.plan(sms, q0, target, duration),
    )


def learnt_before(name: str, seed: int) -> dict[str, Any]:
    """Return the final error [m] of a motion planned once, with and without prior identification."""
    sms, q0, target, duration = case(name)
    teach, plan = taught(name)
    plant = wrong(sms, seed)
    before = flown(sms, plan, plant, q0).position_error[-1]
    shown = flown(sms, teach, plant, q0)
    found = identification.identify(
        sms,
        recording=measured(sms, shown.t, shown.q, shown.v, seed),
        unknown=["base", *sms.joint_names],
        sensors=CLASS,
        spread=OFF,
        at_rest=True,
    )
    again = opt.plan(found.sms, q0, target, duration)
    return {"without": float(before), "with": float(flown(found.sms, again, plant, q0).position_error[-1])}


def errors_row(name: str, runs: list[dict[str, Any]]) -> list[str]:
    """Return the row with the number of plans that end within `WITHIN`."""
    words = []
    for key in ("without", "with"):
        errors = np.array([run[key] for run in runs])
        count = f"{np.sum(errors <= WITHIN)} of {len(errors)}"
        words.append(f"{count} (median {1e3 * np.median(errors):.2f} mm)")
    return [f"{name}, errors of 15 %, planned once: within 2 mm", *words]


def payload(seed: int) -> dict[str, Any]:
    """Return whether a flight with an unknown payload ends within `WITHIN` and keeps the rate limits."""
    sms, q0, target, duration = case("panda")
    rng, kept = np.random.default_rng(seed), []
    last = int(sms.model.frames[sms.frame_id].parentJoint)
    tip = sms.model.frames[sms.frame_id].placement
    size = rng.uniform(0.05, 0.15, 3)
    turned = 10.0 / 3.0 * np.diag((size**2).sum() - size**2)
    body = pin.Inertia(10.0, tip.act(np.array([0.0, 0.0, size[2]]) + rng.uniform(-0.03, 0.03, 3)), turned)
    bodies = list(sms.model.inertias)[1:]
    bodies[last - 1] = bodies[last - 1] + body
    plant = sms.with_inertias(bodies)
    for learn in (None, identification.Identifier(sms, ["payload"])):
        law = control.ComputedTorque(sms)
        known = None if learn is None else law
        reference = opt.Replanning(opt.Problem(sms, q0, target, duration), learn=learn, law=known)
        try:
            run = simulation.simulate(sms, reference, law, dt=5e-3, q0=q0, plant=plant)
        except FfsmsError:
            kept.append(False)
            continue
        rates = (np.abs(run.v[:, 6:]) <= 1.001 * sms.limits.velocity).all()
        kept.append(bool(rates and run.position_error[-1] <= WITHIN))
    return dict(zip(("without", "with"), kept, strict=True))


def payload_row(runs: list[dict[str, Any]]) -> list[str]:
    """Return the row of flights with an unknown payload."""
    words = [f"{sum(run[key] for run in runs)} of {len(runs)}" for key in ("without", "with")]
    return ["10 kg at the tip, re-planned: within 2 mm and the rate limits", *words]


def by_mujoco(plant: ffsms.SpaceManipulator, model: ffsms.SpaceManipulator, motion: Any) -> Any:
    """Return (t, q, v) of a plant that MuJoCo simulates along a motion."""
    import mujoco

    dt = 2e-3
    engine = mujoco.MjModel.from_xml_string(export.to_mjcf(plant, dt, shapes=False))
    data, law = mujoco.MjData(engine), control.ComputedTorque(model)
    q = motion.q[0]
    data.qpos[:] = np.concatenate([q[:3], q[[6, 3, 4, 5]], q[7:]])
    law.reset(dt)
    rows = []
    for k in range(round(motion.duration / dt)):
        p, u = data.qpos, data.qvel
        q = np.concatenate([p[:3], p[[4, 5, 6, 3]], p[7:]])
        v = np.concatenate([pin.XYZQUATToSE3(q[:7]).rotation.T @ u[:3], u[3:]])
        rows.append((dt * k, q, v))
        data.ctrl[:] = law.torque(q, v, *motion.sample(dt * k))
        mujoco.mj_step(engine, data)
    return tuple(map(np.array, zip(*rows, strict=True)))


@cache
def teaching_base() -> Any:
    """Return the motion that identifies the base of `satellite_panda`."""
    sms, q0, _, _ = case("panda")
    return identification.exciting_motion(sms, q0, 10.0, sensors=CLASS)


def base(seed: int) -> dict[str, Any]:
    """Return relative errors of the base's inertia, nominal and identified from MuJoCo's recording."""
    sms = case("panda")[0]
    mass, inertia = 1.0 + OFF * np.random.default_rng(seed).uniform(-1, 1, 2)
    plant = simulation.perturb(sms, base_mass=mass, base_inertia=inertia)
    t, q, v = by_mujoco(plant, sms, teaching_base())
    recording = measured(sms, t, q, v, seed)
    found = identification.identify(sms, recording=recording, sensors=CLASS, at_rest=True)
    true = plant.model.inertias[1].inertia
    bodies = {"without": sms.model.inertias[1], "with": found["base"]}
    return {key: off(body.inertia, true) for key, body in bodies.items()}


def off(inertia: Any, true: Any) -> float:
    """Return the relative error of an inertia."""
    return float(np.linalg.norm(inertia - true) / np.linalg.norm(true))


def percent(errors: Any) -> str:
    """Return median and largest of relative errors as text."""
    return f"{100.0 * np.median(errors):.2g} %, {100.0 * np.max(errors):.2g} %"


def base_row(runs: list[dict[str, Any]]) -> list[str]:
    """Return the row of the base's inertia."""
    words = [percent([run[key] for run in runs]) for key in ("without", "with")]
    return [f"base inertia from {len(runs)} recordings of MuJoCo, error: median, largest", *words]


@cache
def swung_base() -> tuple[Any, Any]:
    """Return a plant with other base parameters, and the recording of its identification motion."""
    sms, q0, _, _ = case("panda")
    plant = simulation.perturb(sms, base_mass=1.1, base_inertia=0.9, base_com=[0.02, -0.01, 0.03])
    return plant, flown(sms, teaching_base(), plant, q0)


def intervals(seed: int) -> dict[str, Any]:
    """Return how many of ten 95 % intervals contain the true value, and if the estimate is consistent."""
    sms = case("panda")[0]
    plant, run = swung_base()
    recording = measured(sms, run.t, run.q, run.v, seed)
    found = identification.identify(sms, recording=recording, sensors=CLASS)["base"]
    errors = np.abs(found.parameters - plant.inertial_parameters[:10])
    consistent = bool(np.linalg.eigvalsh(pseudo_inertia(found.parameters))[0] > 0.0)
    return {"inside": int((errors <= 1.96 * found.deviation).sum()), "consistent": consistent}


def intervals_row(runs: list[dict[str, Any]]) -> list[str]:
    """Return the row of the intervals."""
    inside = 10.0 * sum(run["inside"] for run in runs) / len(runs)
    counts = f"{inside:.1f} % of {10 * len(runs)}; {sum(run['consistent'] for run in runs)} of {len(runs)}"
    return ["95 % intervals of the base's ten parameters with the true value; consistent", "", counts]


def client(seed: int) -> dict[str, Any]:
    """Return errors of a captured client's mass and inertia, assumed and identified 10 s after the catch."""
    sms, duration, rng = case("panda")[0], 12.0, np.random.default_rng(seed)
    q0 = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8])
    mass, rate = np.exp(rng.uniform(np.log([50.0, 0.5]), np.log([200.0, 3.0])))
    size = rng.uniform(0.4, 0.9, 3) * (mass / 80.0) ** (1.0 / 3.0)
    inertia = mass / 12.0 * ((size**2).sum() - size**2)
    spin = rng.normal(size=3)
    twist = [*rng.uniform(-0.002, 0.002, 3), *np.radians(rate) * spin / np.linalg.norm(spin)]
    joints = np.array([0.3, 0.1, 0.2, -1.4, 0.1, 3.3, 1.0]) + rng.uniform(-0.3, 0.3, 7)
    joints = np.clip(joints, sms.limits.lower + 0.1, sms.limits.upper - 0.1)
    grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5 * size[2] - 0.05]))
    end = sms.at(straight_end(sms, q0, joints, duration, None)).end_effector_pose
    then = ffsms.Client(mass, inertia, end * grasp.inverse(), twist)
    body = ffsms.Client(mass, inertia, then.pose(-duration), then.twist(-duration))
    factors = 1.0 + OFF * rng.uniform(-1.0, 1.0, 2)
    believed = capture.Belief(
        mass=factors[0] * mass, inertia=factors[1] * inertia, mass_deviation=0.1, inertia_deviation=0.1
    )
    flight = capture.fly(
        sms,
        q0,
        opt.Meet(body, grasp),
        duration,
        camera=EXACT,
        belief=believed,
        replan=False,
        control=capture.Control(partial(control.ComputedTorque, K_p=100.0, K_d=20.0), dt=5e-3),
        planning=capture.Planning(dt=0.05),
        procedure=capture.Procedure(identify=8.0, after=10.0),
        conditions=simulation.Conditions(sensors=simulation.Sensors(**{**vars(CLASS), "seed": seed})),
    )
    found = flight.identified
    if found is None:
        return {"outcome": flight.outcome}
    return {
        "believed mass": float(abs(factors[0] - 1.0)),
        "believed inertia": float(abs(factors[1] - 1.0)),
        "mass": abs(found.mass / mass - 1.0),
        "inertia": off(found.inertia, np.diag(inertia)),
        "deviation": found.mass_deviation / mass,
    }


def client_row(runs: list[dict[str, Any]]) -> list[str]:
    """Return the row of captured clients."""
    caught = [run for run in runs if "mass" in run]
    words = [
        "; ".join(f"{what} {percent([run[before + what] for run in caught])}" for what in ("mass", "inertia"))
        for before in ("believed ", "")
    ]
    return [
        f"client, {len(caught)} of {len(runs)} caught, 10 s after the catch, error: median, largest",
        *words,
    ]


def update_time() -> list[str]:
    """Return a row with the mean time of one update in the fastest of 50 series of 192 updates."""
    sms, q0, _, _ = case("panda")
    v = sms.velocity(q0, np.full(sms.n, 0.1))
    words = []
    for unknown in (["base"], ["base", "payload"]):
        identifier, best = identification.Identifier(sms, unknown, sensors=CLASS), np.inf
        for block in range(50):
            begun = time.process_time()
            for k in range(192):
                identifier.update(1.0 * (192 * block + k), q0, v)
            best = min(best, (time.process_time() - begun) / 192)
        words.append(f"{1e6 * best:.0f} us ({', '.join(unknown)})")
    return ["CPU time of one update of `Identifier`", "", ", ".join(words)]


# For each row: functions that run one seed and format the row, and the number of runs per `--count`.
Run = tuple[Callable[[int], dict[str, Any]], Callable[[list[dict[str, Any]]], list[str]], float]
RUNS: dict[str, Run] = {
    "planar": (partial(learnt_before, "planar"), partial(errors_row, "planar_3r"), 1),
    "panda": (partial(learnt_before, "panda"), partial(errors_row, "satellite_panda"), 1),
    "payload": (payload, payload_row, 0.25),
    "base": (base, base_row, 0.25),
    "client": (client, client_row, 0.25),
    "intervals": (intervals, intervals_row, 2.5),
}
ROWS = (*RUNS, "time")


def main() -> None:
    """Run the chosen rows and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", choices=[[], *ROWS])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--resume", type=Path, help="a file of runs, to which new ones are added")
    given, rows = parser.parse_args(), []
    kept: dict[tuple[str, int], dict[str, Any]] = {}
    if given.resume is not None and given.resume.exists():
        for line in given.resume.read_text("utf-8").splitlines():
            run = json.loads(line)
            kept[run.pop("row"), run.pop("seed")] = run
    for name in given.rows or ROWS:
        if name == "time":
            rows.append(update_time())
            continue
        measure, row, each = RUNS[name]
        for seed in range(math.ceil(each * given.count)):
            if (name, seed) not in kept:
                kept[name, seed] = measure(seed)
                if given.resume is not None:
                    with given.resume.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"row": name, "seed": seed, **kept[name, seed]}) + "\n")
        if runs := [run for (kind, _), run in kept.items() if kind == name]:
            rows.append(row(runs))
    print(markdown(["measured", "without", "with identification"], rows))


if __name__ == "__main__":
    main()
