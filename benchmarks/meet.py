"""Plans that meet tumbling clients, which can be met by construction.

Each case: a 7-joint arm at a random posture; random joints within reach of it in a straight joint-space move,
where the end effector then is, and a client that tumbles so that its grasp is there at the deadline. Its
corridor is entered along the end effector's z axis.

    python benchmarks/meet.py --clients 200
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.trajectory import measure

DEG = np.pi / 180.0
DURATION = 20.0


def case(sms: ffsms.SpaceManipulator, rng: np.random.Generator) -> tuple[np.ndarray, ffsms.Client, pin.SE3]:
    """Start, client and grasp: joints that clear the robot's own body at both ends and in between."""
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    while True:
        start = middle + 0.7 * half * rng.uniform(-1.0, 1.0, sms.n)
        way = rng.uniform(-1.0, 1.0, sms.n)
        end = np.clip(start + way, middle - 0.8 * half, middle + 0.8 * half)
        q0 = sms.configuration(start)
        # A straight move whose rates rise and fall smoothly, rolled out with the base free.
        s = np.linspace(0.0, 1.0, 201)
        rates = (end - start) / DURATION * (30.0 * s**2 * (1.0 - s) ** 2)[:, None]
        problem = opt.Problem(sms, q0, [0.0, 0.0, 0.0], DURATION, DURATION / 200)
        straight = measure(problem, rates)
        if straight.clear:
            break
    tip = sms.at(straight.q[-1]).end_effector_pose
    # The client: mass 0.2 to 2 times the servicer's, a box of 0.5 to 1.5 m of that mass, up to 5 deg/s.
    mass = pin.computeTotalMass(sms.model) * rng.uniform(0.2, 2.0)
    x, y, z = rng.uniform(0.5, 1.5, 3) ** 2
    inertia = mass / 12.0 * np.array([y + z, x + z, x + y])
    spin = rng.normal(size=3)
    spin *= rng.uniform(0.0, 5.0) * DEG / np.linalg.norm(spin)
    # The grasp: within 0.5 m of the centre of mass, its approach not from within the body.
    place = rng.normal(size=3)
    place *= rng.uniform(0.1, 0.5) / np.linalg.norm(place)
    while True:
        turn = pin.Quaternion(*(lambda g: g / np.linalg.norm(g))(rng.normal(size=4))).toRotationMatrix()
        if (turn @ [0.0, 0.0, 1.0]) @ place < -0.5 * np.linalg.norm(place):
            break
    grasp = pin.SE3(turn, place)
    # Where the client must be at the deadline; its motion backwards from there gives its start.
    then = ffsms.Client(mass, inertia, tip * grasp.inverse(), np.concatenate([np.zeros(3), spin]))
    now = ffsms.Client(mass, inertia, then.pose(-DURATION), then.twist(-DURATION))
    at_start = (now.pose(0.0) * grasp).translation - sms.at(q0).end_effector_pose.translation
    if np.linalg.norm(at_start) < opt.Meet.standoff:
        return case(sms, rng)  # an arm that stands beside the corridor's tip cannot go through its mouth
    return q0, now, grasp


def main() -> None:
    """Print what became of every client, and the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--robot", default="satellite_panda")
    parser.add_argument("--standoff", type=float, default=opt.Meet.standoff)
    arguments = parser.parse_args()
    sms = ffsms.load(arguments.robot)
    met, times, worst = 0, [], np.zeros(2)
    for seed in range(arguments.first, arguments.first + arguments.clients):
        q0, client, grasp = case(sms, np.random.default_rng(seed))
        goal = opt.Meet(client, grasp, standoff=arguments.standoff)
        began = time.process_time()
        plan = opt.plan(sms, q0, goal, DURATION, 0.02)
        times.append(time.process_time() - began)
        met += plan.reached
        speed, spin = np.linalg.norm(plan.contact_velocity[:3]), np.linalg.norm(plan.contact_velocity[3:])
        if plan.reached:
            worst = np.maximum(worst, [1e3 * speed, spin / DEG])
        row = f"{seed:4d} {'met   ' if plan.reached else 'failed'} {times[-1]:6.2f} s  "
        row += f"{1e3 * plan.position_error[-1]:7.3f} mm  {1e3 * speed:7.3f} mm/s  {spin / DEG:7.3f} deg/s  "
        print(row + plan.note, flush=True)
    print(
        f"{met} of {arguments.clients} met; processor time: median {np.median(times):.2f} s, "
        f"90 % within {np.quantile(times, 0.9):.2f} s; at most {worst[0]:.2f} mm/s and {worst[1]:.3f} deg/s"
    )


if __name__ == "__main__":
    main()
