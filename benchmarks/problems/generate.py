"""Write the 500 problems; each run writes the same files.

Run: python -m benchmarks.problems.generate
Each problem is drawn from a motion that solves it, its witness, which no solver gets. The witness is a
straight joint move, a move through a third posture, a move in the reaction null space, or a move that ends
with nonzero rates. A problem is drawn again if the judge does not accept its witness. Therefore each problem
can be solved, and no planner influences the selection.
"""

from __future__ import annotations

import contextlib
import json
import math
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.problems.draw import (
    CLEARANCE,
    NODES,
    Draw,
    Motion,
    Redraw,
    goal,
    moving_end,
    placed,
    profile,
    rounded,
)
from benchmarks.problems.judge import EXACT, FAMILIES, HERE, Array, World, client_of, judge

SEED = 26
ARMS = ("ur5", "panda", "xarm7")
# The number of problems of each family, and the robots, which alternate.
SETS: dict[str, tuple[int, tuple[str, ...]]] = {
    "positions": (100, ("planar_3r", *ARMS, "space_arm_7")),
    "poses": (100, (*ARMS, "space_arm_7")),
    "held": (70, ("planar_3r", *ARMS, "space_arm_7")),
    "obstacles": (80, (*ARMS, "space_arm_7")),
    "clients": (60, ARMS),
    "two_arms": (50, ("two_arms",)),
    "momentum": (40, ("planar_3r", *ARMS)),
}
HELD = (0.1, 0.3, 1.0)  # [deg] limits on the base's attitude, in turn
OBSTACLES, TRIES = 8, 60  # number of obstacles, of which some may fit nowhere; number of draws for each
FAR = 0.15  # [arm lengths] least displacement of the end effector while the base is held
BODY, HANDLE = (0.6, 0.6, 0.5), 0.12  # [m] a client's body, and by how much its grasp sticks out
SPIN = (1.0, 10.0)  # [deg/s] range of the clients' rates
CARRIED = (0.2, 0.5)  # largest displacement of the centre of mass [m] and rotation [rad] by the momentum
CLIENT_TURN = 0.2  # [rad] tolerance of the attitude of a client's grasp in the last tenth


def plain(draw: Draw, turned: bool) -> Motion:
    """Set a position or a pose as goal, and return its witness, a straight move."""
    other = draw.posture(0.9)
    draw.clear(draw.world, draw.world.q0, np.concatenate([draw.world.q0[:7], other]))
    motion = draw.straight(draw.start, other)
    tips = draw.tips(draw.rolled(motion)[-1])
    draw.problem["goals"] = [goal(draw.frames[0], tips[0], turned)]
    return motion


def held(draw: Draw) -> Motion:
    """Set a limit on the base attitude, and return its witness, a move in the reaction null space."""
    way, length = draw.rng.normal(size=draw.world.n), draw.rng.uniform(1.5, 4.0)
    way /= np.linalg.norm(way)
    draw.clear(draw.world, draw.world.q0)

    def slope(joints: Array) -> Array:
        spin = draw.world.jacobians(np.concatenate([draw.world.q0[:7], joints]), draw.world.frames[0])[0][3:]
        _, sigma, V = np.linalg.svd(spin)
        free = V[int((sigma > 1e-9 * sigma[0]).sum()) :]
        return np.asarray(free.T @ (free @ way))

    joints, slopes, h = [draw.start], [slope(draw.start)], length / NODES
    for _ in range(NODES):
        middle = slope(joints[-1] + 0.5 * h * slopes[-1])
        joints.append(joints[-1] + h * middle)
        slopes.append(slope(joints[-1]))
    # The speed along the path has a ramp at both ends.
    gone, speed = profile(NODES)
    points = np.column_stack([np.interp(gone[:, 0] * NODES, range(NODES + 1), x) for x in np.array(joints).T])
    rates = speed * length * np.array([slope(x) for x in points])
    motion = draw.timed(points, rates, 1.0, 0.9)
    rolled = draw.rolled(motion)
    first, last = (draw.tips(rolled[k])[0] for k in (0, -1))
    if np.linalg.norm(last.translation - first.translation) < FAR * draw.length:
        raise Redraw
    most = HELD[draw.index % 3]
    lever = draw.world.model.inertias[1].lever
    centres = np.array([pin.XYZQUATToSE3(q[:7]).act(lever) for q in rolled])
    shift = float(np.linalg.norm(centres - centres[0], axis=1).max())
    tight = draw.index % 4 == 3
    draw.problem["limits"]["base_attitude"] = round(math.radians(most), 9)
    draw.problem["limits"]["base_translation"] = round(1.3 * shift, 6) if tight else None
    posed = draw.world.n > 6 and most == HELD[-1]
    draw.problem["goals"] = [goal(draw.frames[0], last, posed)]
    return motion


def obstacles(draw: Draw) -> Motion:
    """Set obstacles on the path of the straight move and beside a detour, and return the detour."""
    rng, other = draw.rng, draw.posture(0.9)
    aside = 0.5 * (draw.start + other) + rng.uniform(-1.5, 1.5, draw.world.n)
    draw.clear(draw.world, draw.world.q0, np.concatenate([draw.world.q0[:7], other]))
    direct = draw.rolled(draw.straight(draw.start, other))
    motion = draw.straight(draw.start, np.clip(aside, draw.low, draw.high), other)
    rolled = draw.rolled(motion)
    draw.clear(draw.world, *rolled[::10])
    for k in range(TRIES):
        if len(draw.problem["obstacles"]) == OBSTACLES:
            break
        # The first obstacles are on the path of the straight move, the others beside the detour.
        blocks = len(draw.problem["obstacles"]) < 3
        near = direct[NODES // 2 + rng.integers(-60, 60)] if blocks else rolled[rng.integers(len(rolled))]
        size, kind = draw.length * rng.uniform(0.08, 0.2, 3), ("box", "sphere", "cylinder")[k % 3]
        sizes = {"box": size, "sphere": 0.5 * size[:1], "cylinder": [0.5 * size[0], size[1]]}[kind]
        turn = pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix()
        away = rng.normal(size=3) * draw.length * (0.05 if blocks else 0.15)
        pose = pin.SE3(turn, draw.tips(near)[0].translation + away)
        one = {"shape": kind, "size": rounded(sizes), **placed(pose), "on": "inertial"}
        with contextlib.suppress(Redraw):
            draw.clear(World(draw.problem | {"obstacles": [one]}), *rolled[::10], rolled[-1])
            draw.problem["obstacles"].append(one)
    world = World(draw.problem)
    if all(world.apart(q) == CLEARANCE for q in direct[::5]):
        raise Redraw
    draw.problem["goals"] = [goal(draw.frames[0], draw.tips(rolled[-1])[0], draw.index % 8 >= 4)]
    return motion


def clients(draw: Draw) -> Motion:
    """Set a tumbling client, and return its witness, a move that ends with the velocity of the grasp."""
    rng, other = draw.rng, draw.posture(0.8)
    draw.clear(draw.world, draw.world.q0, np.concatenate([draw.world.q0[:7], other]))
    end, wanted = rng.uniform(-1.0, 1.0, draw.world.n), math.radians(rng.uniform(*SPIN))
    motion = moving_end(draw, other, np.zeros(draw.world.n))
    for _ in range(2):
        q = draw.rolled(motion)[-1]
        J = draw.world.jacobians(q, draw.world.frames[0])[1]
        end *= wanted / np.linalg.norm(J[3:] @ end)
        if (np.abs(end) > 0.5 * draw.fastest).any():
            raise Redraw
        motion = moving_end(draw, other, end)
    q = draw.rolled(motion)[-1]
    tip, twist = draw.tips(q)[0], draw.world.jacobians(q, draw.world.frames[0])[1] @ end
    mass = pin.computeTotalMass(draw.world.model) * rng.uniform(0.2, 2.0)
    x, y, z = rng.uniform(0.5, 1.5, 3) ** 2
    place = rng.normal(size=3)
    place *= rng.uniform(0.1, 0.5) / np.linalg.norm(place)
    grasp = pin.SE3(pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix(), place)
    pose = tip * grasp.inverse()
    spin = twist[3:]
    velocity = twist[:3] - np.cross(spin, tip.translation - pose.translation)
    given = {"mass": round(mass, 3), "inertia": rounded(mass / 12.0 * np.array([y + z, x + z, x + y]))}
    # Its motion backwards from the deadline is that of the same body with reversed angular velocity.
    back = client_of(given | placed(pose) | {"twist": np.concatenate([-velocity, -spin])})
    then, reverse = back.states(np.linspace(0.0, draw.problem["duration"], 4 * NODES + 1))[-1]
    draw.problem["client"] = given | placed(then) | {"twist": rounded(-reverse)}
    body = grasp * pin.SE3(np.eye(3), np.array([0.0, 0.0, HANDLE + 0.5 * BODY[2]]))
    draw.problem["obstacles"] = [{"shape": "box", "size": list(BODY), **placed(body), "on": "client"}]
    meet = {"on": "client", "orientation_reach": CLIENT_TURN, "tolerance": EXACT}
    draw.problem["goals"] = [goal(draw.frames[0], grasp, True, **meet)]
    return motion


def two_arms(draw: Draw) -> Motion:
    """Set a goal for each arm, an exact one for the second arm, and return the witness."""
    other = np.clip(draw.start + draw.rng.uniform(-1.2, 1.2, draw.world.n), 0.9 * draw.low, 0.9 * draw.high)
    draw.clear(draw.world, draw.world.q0, np.concatenate([draw.world.q0[:7], other]))
    motion = draw.straight(draw.start, other)
    first, second = draw.tips(draw.rolled(motion)[-1])
    left, posed = goal(draw.frames[0], first, draw.index % 3 > 0), draw.index % 3 == 2
    draw.problem["goals"] = [left, goal(draw.frames[1], second, posed, tolerance=EXACT)]
    return motion


def momentum(draw: Draw) -> Motion:
    """Set a momentum, and return a move at whose end the end effector is at rest."""
    rng, other = draw.rng, draw.posture(0.8)
    draw.clear(draw.world, draw.world.q0, np.concatenate([draw.world.q0[:7], other]))
    turned, end = not draw.flat and draw.index % 8 >= 4, np.zeros(draw.world.n)
    motion = moving_end(draw, other, end)
    duration = draw.problem["duration"]
    shift, turn = (most * rng.uniform(-1.0, 1.0, 3) / duration for most in CARRIED)
    if draw.flat:
        shift[2] = turn[:2] = 0.0
    A = pin.computeCentroidalMap(draw.world.model, draw.world.data, draw.world.q0)
    R = pin.XYZQUATToSE3(draw.world.q0[:7]).rotation
    carried = A[3:, 3:6] @ R.T @ turn
    mass = pin.computeTotalMass(draw.world.model)
    draw.problem["momentum"] = rounded(np.concatenate([mass * shift, carried]))
    world = World(draw.problem)
    for _ in range(6):
        q = draw.rolled(motion, world)[-1]
        _, J, drift = world.jacobians(q, world.frames[0])
        rows = slice(6 if turned else 3)
        end = -np.linalg.pinv(J[rows], rcond=1e-3) @ drift[rows]
        if (np.abs(end) > 0.5 * draw.fastest).any():
            raise Redraw
        motion = moving_end(draw, other, end)
    draw.problem["goals"] = [goal(draw.frames[0], draw.tips(draw.rolled(motion, world)[-1])[0], turned)]
    return motion


MAKERS = {
    "positions": lambda draw: plain(draw, False),
    "poses": lambda draw: plain(draw, True),
    **{one.__name__: one for one in (held, obstacles, clients, two_arms, momentum)},
}


def made(family: str, index: int) -> tuple[dict[str, Any], Motion]:
    """Return a problem and its witness."""
    robots, rng = SETS[family][1], np.random.default_rng([SEED, FAMILIES.index(family), index])
    while True:
        draw = Draw(robots[index % len(robots)], rng, index)
        try:
            witness = MAKERS[family](draw)
        except Redraw:
            continue
        draw.problem["name"] = f"{family}-{index:03d}"
        if judge(draw.problem, witness)["solved"]:
            return draw.problem, witness


def main() -> None:
    """Write all files."""
    for family, (count, _) in SETS.items():
        with open(HERE / f"{family}.jsonl", "w", encoding="utf-8") as file:
            for index in range(count):
                file.write(json.dumps(made(family, index)[0]) + "\n")
                print(f"\r{family} {index + 1} of {count}", end="", flush=True)
        print()


if __name__ == "__main__":
    main()
