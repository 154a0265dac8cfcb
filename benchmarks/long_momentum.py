"""Plan motions of a minute or more for long and loaded arms while the whole robot tumbles.

A target is the end effector's position at the end of a straight joint move from rest to rest, rolled out with
the total momentum. This move is a solution: its joints use at most two thirds of their rate and acceleration
limits and 90 % of their ranges, and its bodies stay 190 mm apart. The goal's reach (tolerance) is 1.1 times
the largest error of this move in the last tenth of the time, at least 20 mm; the robot rotates in this time
while its joints come to rest. A target counts as reached if `reached` is true and if a rollout of the plan in
finer steps ends within 1 mm and stays within the reach. Run: python benchmarks/long_momentum.py

With `--plain` the reach is the default of 20 mm. To stay within 20 mm of its target in the last tenth of the
time, a robot that rotates must move its joints against its rotation. The table then has the number of targets
that are met at the deadline, and the number of these at which the end effector also stays within the reach.
For all other targets it has the number of those at which some posture could keep the end effector in place.
This is checked for postures in which a straight move reaches the target at 0.9 of the time. A linear
program in each of 20 steps finds the joint rates that keep the end effector in place with the
smallest share of their limits, within the joints' ranges.

Sources of the robots: [1] International Journal of Aerospace Engineering 2019, 2679152, Table 2 (an SSRMS-
type arm of 7 joints), as packaged in `space_arm_7`, here on a bus of 1,500 kg; [2] Orbital Express: arm of
6 joints, 3 m, 71 kg, on ASTRO, 952 kg (R. B. Friend, "Orbital Express program summary and mission
overview", SPIE 6958, 2008), here with 400 kg in hand; [3] Shuttle RMS: 6 joints, booms of 6.4 m and 7.1 m
with 138 kg and 85 kg, 410 kg in all (B. A. Aikenhead et al., "Canadarm and the Space Shuttle", J. Vac.
Sci. Technol. A 1, 1983), here on a bus of 5,000 kg with 200 kg in hand. Link widths,
wrist masses and joint ranges are assumed.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog
from table import markdown

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import prepared
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.opt.search.inverse_kinematics import joint_goals, moves_to, spread_postures
from ffsms_pin.opt.search.spline import FINE as GRID, rate_spline
from ffsms_pin.robot.base_motion import advance, roll_out
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.threads import one_blas_thread

DRIFTS = (0.0, 0.5, 1.0, 2.0)  # [deg/s]
SHORTEST, LONGEST = 60.0, 180.0  # [s]
CLEAR = 0.19  # [m]
SHARE = 0.9  # share of the joints' ranges
USED = 2.0 / 3.0  # share of the joints' rate and acceleration limits
STEPS, FINE = 400, 10  # steps of a plan; steps of the independent rollout per step of the plan
EXACT = 1e-3  # [m]


class Link(NamedTuple):
    """A uniform rod along x behind a joint about `axis`: length [m], mass [kg], radius [m]."""

    axis: tuple[int, int, int]
    length: float
    mass: float
    radius: float


class Arm(NamedTuple):
    """A bus, its mass [kg] and sides [m], with an arm: links, joint rate [rad/s], ranges [rad], load [kg]."""

    mass: float
    sides: tuple[float, float, float]
    links: tuple[Link, ...]
    rate: float
    ranges: tuple[float, ...]
    load: float = 0.0


ROLL, PITCH, YAW = (1, 0, 0), (0, 1, 0), (0, 0, 1)
ARMS = {
    "slender, 12.5 m": Arm(
        1500.0,
        (2.2, 2.1, 2.0),
        (
            Link(ROLL, 0.5, 42.5, 0.05),
            Link(YAW, 0.5, 42.5, 0.05),
            Link(PITCH, 5.0, 70.0, 0.05),
            Link(PITCH, 5.0, 70.0, 0.05),
            Link(PITCH, 0.5, 42.5, 0.05),
            Link(YAW, 0.4, 42.5, 0.05),
            Link(ROLL, 0.6, 42.5, 0.05),
        ),
        np.deg2rad(4.0),
        (3.1, 1.4, 1.4, 2.3, 1.8, 1.8, 3.1),
    ),
    "400 kg in hand": Arm(
        952.0,
        (1.8, 1.8, 1.8),
        (
            Link(YAW, 0.3, 12.0, 0.08),
            Link(PITCH, 1.2, 17.0, 0.06),
            Link(PITCH, 1.0, 14.0, 0.06),
            Link(PITCH, 0.2, 10.0, 0.06),
            Link(YAW, 0.2, 10.0, 0.06),
            Link(ROLL, 0.1, 8.0, 0.06),
        ),
        np.deg2rad(4.0),
        (2.6, 1.4, 2.3, 1.6, 1.6, 3.1),
        400.0,
    ),
    "Shuttle's arm": Arm(
        5000.0,
        (3.0, 3.0, 3.0),
        (
            Link(YAW, 0.3, 60.0, 0.15),
            Link(PITCH, 6.4, 138.0, 0.17),
            Link(PITCH, 7.1, 85.0, 0.17),
            Link(PITCH, 0.5, 47.0, 0.15),
            Link(YAW, 0.7, 40.0, 0.15),
            Link(ROLL, 0.7, 40.0, 0.15),
        ),
        np.deg2rad(2.3),
        (2.6, 1.4, 2.4, 1.8, 1.8, 3.1),
        200.0,
    ),
}


class Task(NamedTuple):
    """A start, a momentum, a target, a duration, the goal's reach [m] and the straight move's joint goal."""

    q0: FloatArray
    momentum: FloatArray
    target: FloatArray
    duration: float
    reach: float
    joint_goal: FloatArray


def robot(arm: Arm) -> ffsms.SpaceManipulator:
    """Build the robot; the load is a cube of 500 kg/m^3 at the end effector."""
    joints, links = [], [_link("base", arm.mass, 0.0, arm.sides)]
    side, place, parent = 0.5 * arm.sides[0], (0.5 * arm.sides[0], 0.0, 0.0), "base"
    effort = 2500.0
    for i, (link, most) in enumerate(zip(arm.links, arm.ranges, strict=True)):
        name = f"link_{i + 1}"
        links.append(_link(name, link.mass, link.length, (link.length, link.radius, link.radius)))
        limit = f'<limit lower="{-most}" upper="{most}" velocity="{arm.rate}" effort="{effort}"/>'
        joints.append(_joint(f"joint_{i + 1}", "revolute", parent, name, place, link.axis, limit))
        parent, place = name, (link.length, 0.0, 0.0)
    if arm.load:
        side = (arm.load / 500.0) ** (1.0 / 3.0)
        links.append(_link("load", arm.load, side, (side, side, side)))
        joints.append(_joint("grip", "fixed", parent, "load", place, ROLL, ""))
    links.append('<link name="tool"/>')
    joints.append(_joint("mount", "fixed", parent, "tool", place, ROLL, ""))
    urdf = f'<robot name="long_arm">{"".join(links)}{"".join(joints)}</robot>'
    model = pin.buildModelFromXML(urdf, pin.JointModelFreeFlyer())
    shapes = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.COLLISION)
    return ffsms.load(model, end_effector="tool", collision=shapes)


def _link(name: str, mass: float, length: float, size: Sequence[float]) -> str:
    """Return the URDF of a rod along x from its joint, or of a box (equal sides, or no length)."""
    rod = size[1] < 0.25 * max(length, 1e-9) or (length > 0.0 and size[1] != size[0])
    x, y, z = size
    if rod:
        across = mass * (length**2 / 12.0 + y**2 / 4.0)
        inertia = (0.5 * mass * y**2, across, across)
        shape = f'<cylinder radius="{y}" length="{0.9 * length}"/>'
    else:
        inertia = (mass * (y**2 + z**2) / 12.0, mass * (x**2 + z**2) / 12.0, mass * (x**2 + y**2) / 12.0)
        shape = f'<box size="{x} {y} {z}"/>'
    at = f'<origin xyz="{0.5 * length} 0 0" rpy="0 {0.5 * math.pi if rod else 0.0} 0"/>'
    tensor = " ".join(f'i{a}{a}="{value}"' for a, value in zip("xyz", inertia, strict=True))
    return (
        f'<link name="{name}"><inertial><origin xyz="{0.5 * length} 0 0"/><mass value="{mass}"/>'
        f'<inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial>'
        f"<collision>{at}<geometry>{shape}</geometry></collision></link>"
    )


def _joint(
    name: str, kind: str, parent: str, child: str, place: Sequence[float], axis: Sequence[int], limit: str
) -> str:
    xyz = " ".join(str(float(value)) for value in place)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>{limit}</joint>'
    )


def tasks(sms: ffsms.SpaceManipulator, drift: float, count: int, seed: int) -> Iterator[Task]:
    """Draw targets; `drift` [rad/s] is the robot's angular velocity at the start, about a random axis."""
    rng, limits, stack = np.random.default_rng(seed), sms.limits, ArmStack(sms)
    apart = prepared(opt.Clearance(CLEAR), sms)
    s = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    while count:
        start, joint_goal = (SHARE * limits.upper * rng.uniform(-1.0, 1.0, sms.n) for _ in range(2))
        way, axis, share = joint_goal - start, rng.normal(size=3), rng.uniform()
        least = max(1.5 * np.max(np.abs(way) / limits.velocity) / USED, SHORTEST)
        duration = float(np.round(least + share * (LONGEST - least)))
        if least > LONGEST or np.any(6.0 * np.abs(way) / duration**2 > USED * limits.acceleration):
            continue
        q0 = sms.configuration(start)
        inertia = np.linalg.inv(stack.evaluate(start[:, None]).inverse[..., 0])
        momentum = np.concatenate([np.zeros(3), inertia @ (drift * axis / np.linalg.norm(axis))])
        rates = 6.0 * s * (1.0 - s) * way / duration
        motion = rolled_out(sms, stack, q0, rates, duration / STEPS, momentum)
        if apart.violation(motion).amount > 0.0:
            continue
        tip = motion.end_effector[:, 0]
        late = motion.times >= 0.9 * duration
        reach = 1.1 * float(np.linalg.norm(tip[:, late] - tip[:, -1:], axis=0).max())
        yield Task(q0, momentum, tip[:, -1], duration, max(reach, 0.02), joint_goal)
        count -= 1


def run(name: str, drift: float, count: int, seed: int, plain: bool = False) -> list[dict[str, Any]]:
    """Plan to `count` targets of one robot at one drift [deg/s]; `plain`: with the default reach."""
    sms, rows = robot(ARMS[name]), []
    for task in tasks(sms, np.deg2rad(drift), count, seed):
        goal = task.target if plain else opt.Position(task.target, reach=task.reach)
        dt, begin = task.duration / STEPS, time.process_time()
        momentum = task.momentum if drift else None
        plan = opt.plan(sms, task.q0, goal, task.duration, dt, momentum=momentum)
        seconds = time.process_time() - begin
        fine = np.repeat(plan.joint_accelerations, FINE, axis=0)
        q, _ = roll_out(sms, task.q0, np.zeros(sms.n), fine, dt / FINE, task.momentum)
        late = q[round(0.9 * STEPS) * FINE :: FINE]
        errors = [np.linalg.norm(sms.at(one).end_effector_pose.translation - task.target) for one in late]
        reach = 0.02 if plain else task.reach
        met = errors[-1] <= EXACT
        reached = met and plan.reached and max(errors) <= reach + EXACT
        rows.append(
            {
                "robot": name,
                "drift": drift,
                "duration": task.duration,
                "met": bool(met),
                "reached": bool(reached),
                "holding": least_holding(sms, task) if plain and met and not reached else 0.0,
                "end": float(errors[-1]),
                "late": float(max(errors)),
                "reach": task.reach,
                "seconds": seconds,
                "note": plan.note,
            }
        )
    return rows


def least_holding(sms: ffsms.SpaceManipulator, task: Task, tried: int = 48) -> float:
    """Return the smallest `holding_share` of postures that reach the target at 0.9 of the time."""
    early = opt.Problem(
        sms, task.q0, task.target, 0.9 * task.duration, task.duration / STEPS, momentum=task.momentum
    )
    spline = rate_spline(early.steps, early.dt, GRID)
    goals = joint_goals(early, np.vstack([early.joints0, spread_postures(early, 0, tried)])).arrived(early)
    least = math.inf
    for points in moves_to(early, spline, goals):
        rates = spline.rates_at(early.nodes).of(points, early.joint_rates)
        slopes = np.diff(rates, axis=0) / early.dt
        q, _ = roll_out(sms, task.q0, np.zeros(sms.n), slopes, early.dt, task.momentum)
        least = min(least, holding_share(sms, q[-1], task, most=least))
    return least


def holding_share(
    sms: ffsms.SpaceManipulator, q: FloatArray, task: Task, most: float, steps: int = 20
) -> float:
    """Return the share of the rate limits that keeps the end effector in place, from q (nq,) on.

    The share is infinite if the joints leave their ranges, or if it exceeds `most`.
    """
    n, limits, dt, largest = sms.n, sms.limits, 0.1 * task.duration / steps, 0.0
    uses = np.block([[np.eye(n), -limits.velocity[:, None]], [-np.eye(n), -limits.velocity[:, None]]])
    for _ in range(steps):
        state = sms.at(q, sms.velocity(q, np.zeros(n), task.momentum))
        off = task.target - state.end_effector_pose.translation
        wanted = off / dt - state.end_effector_twist[:3]
        joints = sms.layout.positions(q)
        ranges = [*zip((limits.lower - joints) / dt, (limits.upper - joints) / dt, strict=True), (0.0, None)]
        columns = np.hstack([state.J_star[:3], np.zeros((3, 1))])
        solved = linprog(np.append(np.zeros(n), 1.0), uses, np.zeros(2 * n), columns, wanted, ranges)
        if not solved.success or solved.fun > most:
            return math.inf
        largest = max(largest, float(solved.fun))
        q, _ = advance(sms, q, solved.x[:n], np.zeros(n), dt, task.momentum, "floating")
    return largest


def report(rows: list[dict[str, Any]], plain: bool = False) -> str:
    """Return a table of reached targets and mean CPU times, also relative to runs without momentum."""
    lines = []
    for name in dict.fromkeys(row["robot"] for row in rows):
        at_rest = [row["seconds"] for row in rows if row["robot"] == name and not row["drift"]]
        for drift in dict.fromkeys(row["drift"] for row in rows):
            some = [row for row in rows if row["robot"] == name and row["drift"] == drift]
            seconds = [row["seconds"] for row in some]
            left = [row["holding"] for row in some if row["met"] and not row["reached"]]
            lines.append(
                [
                    name,
                    f"{drift:g}",
                    *([f"{sum(row['met'] for row in some)} of {len(some)}"] if plain else []),
                    f"{sum(row['reached'] for row in some)} of {len(some)}",
                    *([f"{sum(share <= 1.0 for share in left)} of {len(left)}"] if plain else []),
                    f"{1e3 * np.median([row['end'] for row in some]):.3g}",
                    f"{np.mean(seconds):.2f}",
                    f"{np.mean(seconds) / np.mean(at_rest):.2g}" if at_rest else "",
                ]
            )
    counts = ["at the target at the end", "and in the last tenth"]
    counts.append("not in the last tenth: some posture could hold the target")
    times = ["final error, median [mm]", "CPU time, mean [s]", "relative to no drift"]
    return markdown(["robot", "drift [deg/s]", *counts, *times], lines)


@one_blas_thread()
def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="targets of each robot and drift (default: 20)")
    parser.add_argument("--seed", type=int, default=1, help="of the targets (default: 1)")
    parser.add_argument("--robots", nargs="+", choices=ARMS, default=list(ARMS), help="default: all")
    parser.add_argument(
        "--drifts", nargs="+", type=float, default=DRIFTS, help="[deg/s] (default: %(default)s)"
    )
    parser.add_argument("--plain", action="store_true", help="goals with the default reach of 20 mm")
    given = parser.parse_args()
    rows = [
        row
        for name in given.robots
        for drift in given.drifts
        for row in run(name, drift, given.count, given.seed, given.plain)
    ]
    print(report(rows, given.plain))
    for row in rows:
        if not row["reached"]:
            print(
                f"\n{row['robot']}, {row['drift']:g} deg/s, {row['duration']:g} s: "
                f"{1e3 * row['end']:.1f} mm off, {1e3 * row['late']:.0f} mm in the last tenth; {row['note']}"
                + (
                    f"; the best other posture needs {row['holding']:.2g} times the rate limits"
                    * (row["holding"] > 0)
                )
            )


if __name__ == "__main__":
    main()
