"""Meet drifting clients that have bodies, with wheels that hold the attitude and with measurement noise.

The cases are those of `benchmarks/meet.py --bodies`, but the client's centre of mass moves with up to 20 mm/s
and wheels hold the servicer's attitude, in the plan and in the simulation. Servicer and client are measured
with noise and delay, and the motion is re-planned until the contact, as `ffsms-pin run` does for such a file.
A client is met if the gripper closes inside the default envelope in one of the attempts. Every other run must
end in an abort with a reason.

    python benchmarks/harder_clients.py --clients 200
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from meet import BODY, CLEARANCE, DURATION, HANDLE, case
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import scenarios
from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.errors import SimulationDiverged
from ffsms_pin.processes import map_in_processes

STEP, PERIOD = 0.05, 0.5  # [s] time step and period of re-planning, longer than by default to save time
MISSES = {"miss_m": 1e3, "miss_deg": 1.0, "contact_velocity_m_per_s": 1e3, "contact_velocity_deg_per_s": 1.0}
UNITS = "{:.2g} mm, {:.2g} deg, {:.2g} mm/s, {:.2g} deg/s"
SPEED = 0.02  # [m/s] largest speed of the centre of mass
AXES = np.eye(3)
# Enough for the heaviest clients at 5 deg/s: with the servicer, their momentum is about 50 N m s.
WHEELS = {"inertia": 0.05, "momentum": 60.0, "torque": 1.0}

FILE = """
[robot]
model = "{robot}"
[start]
joints = {joints}
[wheels]
axes = {axes}
{wheels}
[attitude]
[client]
mass = {mass}
inertia = {inertia}
position = {position}
rpy = {rpy}
velocity = {velocity}
spin = {spin}
[client.sensor]
seed = {seed}
[[obstacle]]
name = "client body"
on = "client"
shape = "box"
size = {size}
position = {body}
rpy = {turn}
[meet]
grasp = {grasp}
grasp_rpy = {turn}
[plan]
duration = {duration}
dt = 0.02
clearance = {clearance}
mode = "rotation-floating"
[reference]
kind = "re-planning"
dt = {step}
period = {period}
[control]
law = "computed-torque"
K_p = 100.0
K_d = 20.0
dt = 0.01
[sensors]
joint_noise = 1e-5
joint_rate_noise = 1e-4
base_position_noise = 1e-3
base_attitude_noise = 1e-4
base_velocity_noise = 1e-3
base_rate_noise = 1e-5
base_latency = 0.05
seed = {seed}
[contact]
after = 0.0
"""


def written(robot: str, sms: ffsms.SpaceManipulator, seed: int) -> str:
    """Return the scenario file of a case."""
    rng = np.random.default_rng(seed)
    q0, client, grasp = case(sms, rng, bodies=True, speed=SPEED, mode="rotation-floating")
    body = grasp * pin.SE3(np.eye(3), np.array([0.0, 0.0, HANDLE + 0.5 * BODY[2]]))
    values: dict[str, Any] = {
        "joints": sms.joint_positions(q0),
        "axes": AXES,
        "inertia": client.inertia,
        "position": client.start_pose.translation,
        "rpy": pin.rpy.matrixToRpy(client.start_pose.rotation),
        "velocity": client.start_twist[:3],
        "spin": client.start_twist[3:],
        "size": np.array(BODY),
        "body": body.translation,
        "grasp": grasp.translation,
        "turn": pin.rpy.matrixToRpy(grasp.rotation),
    }
    listed = {name: np.asarray(value).tolist() for name, value in values.items()}
    wheels = "\n".join(f"{name} = {value}" for name, value in WHEELS.items())
    return FILE.format(
        robot=robot,
        mass=client.mass,
        seed=seed,
        duration=DURATION,
        step=STEP,
        period=PERIOD,
        clearance=CLEARANCE,
        wheels=wheels,
        **listed,
    )


def flown(servicer: tuple[str, ffsms.SpaceManipulator], seed: int) -> tuple[float, dict[str, Any]]:
    """Return the CPU time [s] of a run, and its outcome; a diverged simulation counts as not met."""
    text, began = written(*servicer, seed), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "client.toml"
        path.write_text(text, encoding="utf-8")
        try:
            found = scenarios.run(scenarios.scenario(path))
        except SimulationDiverged as error:
            return time.process_time() - began, {"missed": str(error), "attempts": 0}
    assert found.capture is not None
    return time.process_time() - began, found.capture.numbers()


def print_progress(share: float) -> None:
    """Print the share of completed clients."""
    print(f"{100.0 * share:.0f} % done", file=sys.stderr, flush=True)


def main() -> None:
    """Print the outcome for every client, and a Markdown table of the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--robot", default="satellite_panda")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    arguments = parser.parse_args()
    sms = ffsms.load(arguments.robot).with_actuators(wheels=ReactionWheels(axes=AXES, **WHEELS))
    servicer = arguments.robot, sms
    seeds = range(arguments.first, arguments.first + arguments.clients)
    misses, times, missed = [], [], {}
    runs = map_in_processes(partial(flown, servicer), seeds, arguments.jobs, print_progress)
    for seed, (used, numbers) in zip(seeds, runs, strict=True):
        times.append(used)
        if numbers.get("caught"):
            misses.append([numbers[name] * scale for name, scale in MISSES.items()])
            words = f"met at attempt {numbers['attempts']}"
        else:
            words = missed[seed] = numbers["missed"].partition(";")[0]
        print(f"{seed:4d} {used:6.2f} s  {words}", file=sys.stderr, flush=True)
    met = np.array(misses).reshape(-1, 4)
    rows = [
        ("clients met inside the envelope", f"{len(met)} of {len(times)}"),
        *((f"not met: the client of seed {seed}", words) for seed, words in missed.items()),
        ("errors at contact, median", UNITS.format(*np.median(met, axis=0))),
        ("errors at contact, max", UNITS.format(*met.max(axis=0, initial=0.0))),
        ("CPU time, median", f"{np.median(times):.2g} s"),
        ("CPU time, 90th percentile", f"{np.percentile(times, 90):.2g} s"),
    ]
    print(markdown(("", ""), rows))


if __name__ == "__main__":
    main()
