"""Identification: what wrong plants miss by with and without a motion that teaches, and what is found.

Run from the repository's root:
    python benchmarks/identification.py [ROW ...] [--count 12]
The rows are
    planar, panda   all masses, inertias and centres of mass off by up to 15 %: a learning motion of 10 s with
                    the sensors below, then one plan of 12 s (10 s for the second robot), planned once
    payload         an unknown body of 10 kg at the tip of `satellite_panda`, re-planned with and without
                    learning
    base            base inertia by a recording of MuJoCo, with the sensors below
    intervals       95 % intervals of the base's parameters over seeds of the noise
    time            one update of `Identifier`
Sensors, at 100 Hz: gyros with an angle random walk of 0.0035 deg/sqrt(h) (Honeywell GG1320AN, data sheet),
which is 1e-5 rad/s in a sample; encoders of 19 bit, whose differences show rates to 5e-4 rad/s; a velocity of
the base to 1 mm/s.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import control, export, identification, opt, simulation
from ffsms_pin.errors import FfsmsError
from ffsms_pin.identification.consistency import pseudo_inertia

OFF = 0.15
STEP = 0.01  # [s] of the sensors
CLASS = simulation.Sensors(
    base_rate_noise=1e-5,
    base_velocity_noise=1e-3,
    joint_resolution=2.0 * np.pi / 2**19,
    joint_rate_noise=5e-4,
)
WITHIN = 2e-3  # [m]


def case(name: str) -> tuple[ffsms.SpaceManipulator, Any, Any, float]:
    """Return a robot, its start, its target and the duration of the plan."""
    if name == "planar":
        sms = ffsms.load("planar_3r")
        return sms, sms.configuration(np.radians([1.0, 1.0, 1.0])), [0.45, 0.65, 0.0], 12.0
    sms = ffsms.load("satellite_panda")
    q0 = sms.home()
    return sms, q0, sms.at(q0).end_effector_pose.translation + np.array([0.15, -0.2, 0.1]), 10.0


def wrong(sms: ffsms.SpaceManipulator, seed: int) -> ffsms.SpaceManipulator:
    """Return a plant with all masses, inertias and centres of mass off by up to `OFF`."""
    rng = np.random.default_rng(seed)
    bodies = []
    for body in list(sms.model.inertias)[1:]:
        m, turn, shift = 1.0 + OFF * rng.uniform(-1.0, 1.0, 3)
        lever = body.lever * (shift if np.any(body.lever) else 1.0)
        bodies.append(pin.Inertia(m * body.mass, lever, turn * body.inertia))
    return sms.with_inertias(bodies)


def measured(sms: ffsms.SpaceManipulator, t: Any, q: Any, v: Any, seed: int) -> Any:
    """Return (t, q, v) at the sensors' rate, as they show it."""
    rows = slice(None, None, max(1, round(STEP / float(t[1] - t[0]))))
    shown = simulation.Sensors(**{**vars(CLASS), "seed": seed})
    measure = shown.start(sms, STEP, float(t[-1]) + 1.0)
    pairs = [measure(a, b) for a, b in zip(q[rows], v[rows], strict=True)]
    return t[rows], np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])


def flown(sms: ffsms.SpaceManipulator, reference: Any, plant: ffsms.SpaceManipulator, q0: Any) -> Any:
    """Return the recording of a plant under computed torque of the model."""
    return simulation.simulate(sms, reference, control.ComputedTorque(sms), dt=5e-3, q0=q0, plant=plant)


def learnt_before(name: str, count: int) -> list[str]:
    """Count plants that end within `WITHIN`, planned once with and without a learning motion."""
    sms, q0, target, duration = case(name)
    unknown = ["base", *sms.joint_names]
    teach = identification.exciting_motion(sms, q0, 10.0, unknown=unknown, spread=OFF)
    plan = opt.plan(sms, q0, target, duration)
    before, after = [], []
    for seed in range(count):
        plant = wrong(sms, seed)
        before.append(flown(sms, plan, plant, q0).position_error[-1])
        taught = flown(sms, teach, plant, q0)
        recording = measured(sms, taught.t, taught.q, taught.v, seed)
        found = identification.identify(
            sms, recording=recording, unknown=unknown, sensors=CLASS, spread=OFF, at_rest=True
        )
        again = opt.plan(found.sms, q0, target, duration)
        after.append(flown(found.sms, again, plant, q0).position_error[-1])
    words = [
        f"{np.sum(np.array(e) <= WITHIN)} of {count} (median {1e3 * np.median(e):.2f} mm)"
        for e in (before, after)
    ]
    return [f"{sms.model.name}, 15 % off, planned once: within 2 mm", *words]


def payload(count: int) -> list[str]:
    """Count flights that end within `WITHIN` and keep all rates, with an unknown payload."""
    sms, q0, target, duration = case("panda")
    rng, kept = np.random.default_rng(0), np.zeros((2, count), dtype=bool)
    last = int(sms.model.frames[sms.frame_id].parentJoint)
    tip = sms.model.frames[sms.frame_id].placement
    for k in range(count):
        size = rng.uniform(0.05, 0.15, 3)
        turned = 10.0 / 3.0 * np.diag((size**2).sum() - size**2)
        body = pin.Inertia(10.0, tip.act(np.array([0.0, 0.0, size[2]]) + rng.uniform(-0.03, 0.03, 3)), turned)
        bodies = list(sms.model.inertias)[1:]
        bodies[last - 1] = bodies[last - 1] + body
        plant = sms.with_inertias(bodies)
        for i, learn in enumerate((None, identification.Identifier(sms, ["payload"]))):
            law = control.ComputedTorque(sms)
            known = {} if learn is None else {"learn": learn, "law": law}
            reference = opt.Replanning(opt.Problem(sms, q0, target, duration), **known)
            try:
                run = simulation.simulate(sms, reference, law, dt=5e-3, q0=q0, plant=plant)
            except FfsmsError:
                continue
            rates = (np.abs(run.v[:, 6:]) <= 1.001 * sms.limits.velocity).all()
            kept[i, k] = rates and run.position_error[-1] <= WITHIN
    words = [f"{row.sum()} of {count}" for row in kept]
    return ["10 kg at the tip, re-planned: within 2 mm, all rates kept", *words]


def by_mujoco(plant: ffsms.SpaceManipulator, model: ffsms.SpaceManipulator, motion: Any) -> Any:
    """Return (t, q, v) of MuJoCo's plant that follows a motion."""
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


def base(count: int) -> list[str]:
    """Return the errors of the base's inertia as believed and as found, from recordings of MuJoCo."""
    sms, q0, _, _ = case("panda")
    teach = identification.exciting_motion(sms, q0, 10.0, sensors=CLASS)
    believed, errors = [], []
    for seed in range(count):
        mass, inertia = 1.0 + OFF * np.random.default_rng(seed).uniform(-1, 1, 2)
        plant = simulation.perturb(sms, base_mass=mass, base_inertia=inertia)
        recording = measured(sms, *by_mujoco(plant, sms, teach), seed)
        found = identification.identify(sms, recording=recording, sensors=CLASS, at_rest=True)
        true = plant.model.inertias[1].inertia
        for off, body in ((believed, sms.model.inertias[1]), (errors, found["base"])):
            off.append(np.linalg.norm(body.inertia - true) / np.linalg.norm(true))
    words = [f"{100.0 * np.median(off):.2g} %, {100.0 * np.max(off):.2g} %" for off in (believed, errors)]
    return [f"base inertia by {count} recordings of MuJoCo, error: median, largest", *words]


def intervals(count: int) -> list[str]:
    """Return the share of 95 % intervals that hold the truth."""
    sms, q0, _, _ = case("panda")
    plant = simulation.perturb(sms, base_mass=1.1, base_inertia=0.9, base_com=[0.02, -0.01, 0.03])
    teach = identification.exciting_motion(sms, q0, 10.0, sensors=CLASS)
    run, inside, consistent = flown(sms, teach, plant, q0), 0, 0
    for seed in range(count):
        recording = measured(sms, run.t, run.q, run.v, seed)
        found = identification.identify(sms, recording=recording, sensors=CLASS)["base"]
        off = np.abs(found.parameters - plant.inertial_parameters[:10])
        inside += int((off <= 1.96 * found.deviation).sum())
        consistent += bool(np.linalg.eigvalsh(pseudo_inertia(found.parameters))[0] > 0.0)
    return [
        "95 % intervals of the base's ten parameters hold the truth; consistent",
        "",
        f"{100.0 * inside / (10 * count):.1f} % of {10 * count}; {consistent} of {count}",
    ]


def update_time(count: int) -> list[str]:
    """Return the time of one update, the best of some hundreds in a row."""
    del count
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
    return ["one update of `Identifier`, CPU", "", ", ".join(words)]


ROWS: dict[str, Callable[[int], list[str]]] = {
    "planar": lambda count: learnt_before("planar", count),
    "panda": lambda count: learnt_before("panda", count),
    "payload": payload,
    "base": base,
    "intervals": lambda count: intervals(10 * count),
    "time": update_time,
}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", choices=[[], *ROWS])
    parser.add_argument("--count", type=int, default=12)
    given = parser.parse_args()
    rows = [ROWS[name](given.count) for name in given.rows or ROWS]
    print(markdown(["measured", "without", "with identification"], rows))


if __name__ == "__main__":
    main()
