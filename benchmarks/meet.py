"""Plan rendezvous with tumbling clients, each of which can be met by construction.

A case is a 7-joint arm at a random posture, a straight joint-space move to a random posture nearby, and a
client that tumbles so that its grasp is at the end effector at the deadline. The client's corridor is
entered along the end effector's z axis. Plans that meet the client are checked independently of the planner
(`meet_check.py`). With `--bodies` the client has a body beyond the grasp, which is an obstacle.

    python benchmarks/meet.py --clients 200
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
from meet_check import Judge, Judged
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.trajectory import measure

DEG = np.pi / 180.0
DURATION, DT = 20.0, 0.02  # [s]
CLEARANCE = 0.01  # [m]
SLIGHT = 1e-6  # [m or share of a limit] tolerated violation
BODY = (0.6, 0.6, 0.5)  # [m] size of the client's body with `--bodies`
HANDLE = 0.12  # [m] by which the grasp sticks out of the body


def case(
    sms: ffsms.SpaceManipulator,
    rng: np.random.Generator,
    bodies: bool = False,
    speed: float = 0.0,
    mode: str = "floating",
) -> tuple[np.ndarray, ffsms.Client, pin.SE3]:
    """Draw start, client and grasp, with a straight move to the grasp that has no self-collision.

    With `bodies` the straight move also clears the client's body. The client's centre of mass moves with up
    to `speed` [m/s].
    """
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    while True:
        start = middle + 0.7 * half * rng.uniform(-1.0, 1.0, sms.n)
        way = rng.uniform(-1.0, 1.0, sms.n)
        end = np.clip(start + way, middle - 0.8 * half, middle + 0.8 * half)
        q0 = sms.configuration(start)
        # A straight move whose rates rise and fall smoothly, integrated with a free base.
        s = np.linspace(0.0, 1.0, 201)
        rates = (end - start) / DURATION * (30.0 * s**2 * (1.0 - s) ** 2)[:, None]
        problem = opt.Problem(sms, q0, [0.0, 0.0, 0.0], DURATION, DURATION / 200, mode=mode)
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
    # The grasp: within 0.5 m of the centre of mass, approached from outside of the body.
    place = rng.normal(size=3)
    place *= rng.uniform(0.1, 0.5) / np.linalg.norm(place)
    while True:
        turn = pin.Quaternion(*(lambda g: g / np.linalg.norm(g))(rng.normal(size=4))).toRotationMatrix()
        if (turn @ [0.0, 0.0, 1.0]) @ place < -0.5 * np.linalg.norm(place):
            break
    grasp = pin.SE3(turn, place)
    velocity = np.zeros(3)
    if speed:
        velocity = rng.normal(size=3)
        velocity *= rng.uniform(0.0, speed) / np.linalg.norm(velocity)
    # The client's pose at the deadline; its motion backwards in time gives its start.
    then = ffsms.Client(mass, inertia, tip * grasp.inverse(), np.concatenate([velocity, spin]))
    now = ffsms.Client(mass, inertia, then.pose(-DURATION), then.twist(-DURATION))
    at_start = (now.pose(0.0) * grasp).translation - sms.at(q0).end_effector_pose.translation
    if np.linalg.norm(at_start) < opt.Meet.standoff:
        return case(
            sms, rng, bodies, speed, mode
        )  # an end effector beside the corridor cannot enter through its mouth
    if bodies:
        held = replace(problem, limits=[opt.Clearance(CLEARANCE, "off", obstacles=body_beyond(now, grasp))])
        if not measure(held, rates).clear:
            return case(sms, rng, bodies, speed, mode)
    return q0, now, grasp


def body_beyond(client: ffsms.Client, grasp: pin.SE3) -> list[opt.Obstacle]:
    """Return the client's body, a box beyond the grasp, from which the grasp sticks out."""
    place = grasp * pin.SE3(np.eye(3), np.array([0.0, 0.0, HANDLE + 0.5 * BODY[2]]))
    return [opt.Obstacle(coal.Box(*BODY), place, on=client, name="client")]


def main() -> None:
    """Print the outcome for every client, and a Markdown table of the shares."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--robot", default="satellite_panda")
    parser.add_argument("--standoff", type=float, default=opt.Meet.standoff)
    parser.add_argument("--orientation-reach", type=float, default=opt.Meet.orientation_reach)
    parser.add_argument("--bodies", action="store_true", help="the client's body is an obstacle")
    arguments = parser.parse_args()
    sms = ffsms.load(arguments.robot)
    judge = Judge(sms, CLEARANCE)
    met, times, broken = 0, [], 0
    worst = Judged(0.0, 0.0, 0.0, 0.0, -np.inf, -np.inf, False)
    for seed in range(arguments.first, arguments.first + arguments.clients):
        q0, client, grasp = case(sms, np.random.default_rng(seed), arguments.bodies)
        bodies = body_beyond(client, grasp) if arguments.bodies else []
        goal = opt.Meet(
            client, grasp, standoff=arguments.standoff, orientation_reach=arguments.orientation_reach
        )
        began = time.process_time()
        plan = opt.plan(sms, q0, goal, DURATION, DT, clearance=CLEARANCE, obstacles=bodies)
        times.append(time.process_time() - began)
        row = f"{seed:4d} {'met   ' if plan.reached else 'failed'} {times[-1]:6.2f} s  "
        if plan.reached:
            met += 1
            found = judge.judge(plan, goal, bodies)
            worst = Judged._make(max(pair) for pair in zip(worst, found, strict=True))
            kept = not found.touches and found.limits <= SLIGHT and found.strayed <= goal.tolerance + SLIGHT
            broken += not kept
            row += (
                f"{1e3 * found.position:6.3f} mm {found.attitude / DEG:6.3f} deg  {1e3 * found.speed:6.3f} "
            )
            row += f"mm/s {found.spin / DEG:6.3f} deg/s  {'kept' if kept else f'BROKEN {found}'} "
        print(row + plan.note, file=sys.stderr, flush=True)
    lines = (
        ("clients met", f"{met} of {arguments.clients}"),
        (
            "CPU time, median; 90th percentile",
            f"{np.median(times):.2g} s; {np.quantile(times, 0.9):.2g} s",
        ),
        (
            "errors at contact, max",
            f"{1e3 * worst.position:.2f} mm, {worst.attitude / DEG:.3f} deg, "
            f"{1e3 * worst.speed:.2f} mm/s, {worst.spin / DEG:.3f} deg/s",
        ),
        ("plans that violate a joint limit, the corridor or the clearance", str(broken)),
    )
    print(markdown(("", ""), lines))


if __name__ == "__main__":
    main()
