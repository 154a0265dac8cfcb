"""Simulate captures with noise, interrupted cameras and wrong masses, and check that failures are safe.

Run from the repository's root:
    python benchmarks/captures.py [KIND ...] [--seeds 20] [--first 0] [--resume FILE]
The kinds are
    capture   the packaged scenario with other noise
    dark      the packaged nozzle, without measurements from 40 to 59.5 s; from the fourth seed on, without
              measurements in a random time span
    axis      the packaged nozzle, with a client that rotates at 3 deg/s about a random axis
    drawn     clients of 50 to 3,000 kg at 0.1 to 6 deg/s about any axis; wheels, thrusters or none
    right     random clients whose mass and inertia have errors of the assumed size: the base's rate after
              the catch
    wrong     as `right`, with the servicer's masses off by up to 20 %
    estimate  the clients of `right`, measured until a second before the contact: the base's rate, computed
              without a simulation
Without a kind nothing is simulated. To save time, all kinds but `capture` use control steps of 10 ms, and the
kinds with random clients re-plan only every 0.5 s. With `--resume` each run is a line of that file. Runs in
the file are not simulated again, but are included in the table.

Bodies overlap if a collision shape of the servicer is more than 1 mm inside a body of the client, or 5 mm
inside a nozzle. Coal checks this every 20 ms, or less often if the bodies are further apart than 40 mm. The
hand is checked before the catch only. Its rod may be deeper in a nozzle's wall by its deflection under the
recorded contact force, because the contact model includes the rod's bending in the depth. Control is lost if
a joint exceeds twice its rate limit, is 10 mrad beyond a stop, or is not at rest at the end.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any
from unittest import mock

import coal
import numpy as np
import pinocchio as pin
from scipy.linalg import expm
from table import markdown

from ffsms_pin import scenarios
from ffsms_pin.capture.camera import measured
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.capture.prediction import predicted
from ffsms_pin.errors import FfsmsError
from ffsms_pin.robot.base_motion import straight_end
from ffsms_pin.scenarios import closed_loop
from ffsms_pin.scenarios.definition import packaged_path
from ffsms_pin.scenarios.problems import rendezvous

KINDS = ("capture", "dark", "axis", "drawn", "right", "wrong", "estimate")
OFF = 0.1  # relative standard deviation of a client's assumed mass and inertia
AFTER = 3.0  # [s] after the contact at which the kind `estimate` compares rates
BENDING = 5e3  # [N/m] default stiffness of `capture.probe_in_nozzle`
STEP, DEEP, IN_NOZZLE = 0.02, 1e-3, 5e-3  # [s] between checks; [m] allowed overlap, also in a nozzle
APPROACH = 2.0  # [m/s] largest closing speed of bodies, for less frequent checks of distant bodies
FAST, BEYOND, RESTS = 2.0, 0.01, 0.02  # multiple of rate limits, [rad] beyond stops, [rad/s] at the end
SERVICERS = {
    "none": "",
    "wheels": "[attitude]\n[wheels]\naxes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n"
    "inertia = 0.05\nmomentum = {0}\ntorque = {1}\n",
    "thrusters": "[attitude]\n[thrusters]\n"
    "places = [[0, 1, 0], [0, -1, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [0, 0, 1], [0, 0, -1], "
    "[1, 0, 0], [-1, 0, 0], [1, 0, 0], [-1, 0, 0]]\n"
    "directions = [[0, 0, 1], [0, 0, -1], [0, 0, -1], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [-1, 0, 0], "
    "[1, 0, 0], [0, 1, 0], [0, -1, 0], [0, -1, 0], [0, 1, 0]]\n"
    "force = {1}\nproportional = true\n",
}
MODES = {"none": "floating", "wheels": "rotation-floating", "thrusters": "rotation-flying"}


def put(text: str, key: str, value: Any) -> str:
    """Set an existing key in the text of a scenario file."""
    found, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text, count=1)
    assert count, key
    return found


def swap(text: str, old: str, new: str) -> str:
    """Replace an existing text in a scenario file."""
    assert old in text, old
    return text.replace(old, new)


def seeded(text: str, seed: int) -> str:
    """Set the seeds of plant, sensors and camera."""
    text = re.sub(r"(\[plant\.random\]\n)seed = 1", rf"\g<1>seed = {200 + seed}", text)
    for table in ("[client.sensor]", "[sensors]"):
        text = text.replace(table, f"{table}\nseed = {100 + seed}")
    return text


def packaged(name: str, after: float) -> str:
    """Return the text of a packaged scenario that ends soon after the catch."""
    return re.sub(r"(?m)^after = .*$", f"after = {after}", packaged_path(name).read_text("utf-8"))


def coarse_nozzle(after: float, seed: int) -> str:
    """Return the packaged nozzle with other seeds and twice the control step."""
    return swap(seeded(packaged("nozzle", after), seed), "dt = 0.005 ", "dt = 0.01 ")


def scenario_text(kind: str, seed: int) -> str:
    """Return the scenario file of a run."""
    rng = np.random.default_rng(seed)
    if kind == "capture":
        return seeded(packaged("capture", 2.0), seed)
    if kind == "dark":
        first, last = (40.0, 59.5) if seed < 3 else sorted(rng.uniform([5.0, 15.0], [50.0, 62.0]))
        text = coarse_nozzle(1.0, seed)
        return text.replace("\n[client.belief]", f"hidden = [[{first:.1f}, {last:.1f}]]\n\n[client.belief]")
    if kind == "axis":
        spin = rng.normal(size=3)
        spin *= 3.0 / np.linalg.norm(spin)
        return put(coarse_nozzle(2.0, seed), "spin_deg", spin.tolist())
    while not begins_clear(text := drawn(kind, seed, rng)):
        pass
    return text


def drawn_inertia(inertia: Any, rng: np.random.Generator) -> Any:
    """Draw an inertia (3, 3) about principal ones (3,), with the deviations that `ClientEstimate` assumes."""
    root = np.sqrt(np.diag(0.5 * inertia.sum() - inertia))
    X = OFF * rng.normal(size=(3, 3))
    moments = root @ expm((X + X.T) / np.sqrt(2.0)) @ root
    return np.trace(moments) * np.eye(3) - moments


def drawn(kind: str, seed: int, rng: np.random.Generator) -> str:
    """Return the packaged `capture` with another client, and with another servicer for a heavy client."""
    text = seeded(packaged("capture", 2.0), seed)
    if kind == "drawn":
        mass, rate = np.exp(rng.uniform(np.log([50.0, 0.1]), np.log([3000.0, 6.0])))
    else:
        mass, rate = np.exp(rng.uniform(np.log([50.0, 0.5]), np.log([200.0, 3.0])))
    size = rng.uniform(0.4, 0.9, 3) * (mass / 80.0) ** (1.0 / 3.0)
    x, y, z = size**2
    inertia = mass / 12.0 * np.array([y + z, x + z, x + y])
    spin = rng.normal(size=3)
    spin *= rate / np.linalg.norm(spin)
    believed = ""
    if kind != "drawn":
        believed = (
            f"\n[client.belief]\nmass = {mass * np.exp(OFF * rng.normal())}\n"
            f"inertia = {drawn_inertia(inertia, rng).tolist()}\n"
            f"mass_deviation = {OFF}\ninertia_deviation = {OFF}\n"
        )
    text = put(put(text, "mass", float(mass)), "inertia", inertia.tolist())
    text = put(put(text, "spin_deg", spin.tolist()), "velocity", rng.uniform(-0.002, 0.002, 3).tolist())
    text = re.sub(r"(?m)^size = .*$", f"size = {size.tolist()}", text)
    text = put(text, "grasp", [0.0, 0.0, float(-0.5 * size[2] - 0.05)])
    if mass > 300.0:  # a heavy client needs the servicer of the nozzle scenario and a slower motion
        heavy = packaged_path("nozzle").read_text("utf-8")
        start = re.findall(r"(?m)^joints_deg = (\[.*?\])", heavy)[0]
        client = np.array([14.0, 14.0, -30.0, 51.0, 34.0, -32.0, -78.0]) + rng.uniform(-15.0, 15.0, 7)
        text = put(text, "model", '"servicer"')
        for values in (start, client.tolist()):
            text = re.sub(r"(?m)^joints = .*$", f"joints_deg = {values}", text, count=1)
        text = swap(put(text, "duration", 60.0), "dt = 0.02 ", "dt = 0.1 ")
        text = put(put(text, "standoff", 0.4), "turn_stiffness", 500.0)
        text = put(put(text, "turn_damping", 200.0), "damping", 500.0)
    else:
        joints = np.array([0.3, 0.1, 0.2, -1.4, 0.1, 3.3, 1.0]) + rng.uniform(-0.3, 0.3, 7)
        joints = np.clip(
            joints, [-2.8, -1.7, -2.8, -3.0, -2.8, 0.1, -2.8], [2.8, 1.7, 2.8, -0.2, 2.8, 3.6, 2.8]
        )
        before, header, table = text.partition("[client]\n")
        text = before + header + put(table, "joints", joints.tolist())
        text = swap(put(text, "duration", 20.0), "dt = 0.02 ", "dt = 0.05 ")
    text = swap(text, "dt = 0.002 ", "dt = 0.01 ")
    text = swap(text, 'kind = "re-planning"', 'kind = "re-planning"\nperiod = 0.5')
    text = text.replace("\n[[obstacle]]", f"{believed}\n[[obstacle]]", 1)
    if kind == "wrong":
        text += f"\n[plant.random]\nseed = {seed}\narm_mass = 0.2\nbase_mass = 0.2\nbase_inertia = 0.2\n"
    if kind == "drawn":
        held = tuple(SERVICERS)[seed % 3]
        strong = (2000.0, 20.0) if mass > 300.0 else (60.0, 1.0)
        text = (
            text.replace("[plan]\n", f'[plan]\nmode = "{MODES[held]}"\n')
            + "\n"
            + SERVICERS[held].format(*strong)
        )
    return text


def depth(plant: Any, q: Any, pose: Any, bodies: Any, force: float = 0.0, without: int = -1) -> float:
    """Return the largest depth [m] of a servicer's shapes in bodies at a pose, less the allowed depth.

    The depth is negative if no bodies overlap, and at least -6 m. The contact `force` [N] bends the hand's
    rod. Shapes of the joint `without` are left out.
    """
    hand = int(plant.model.frames[plant.frame_id].parentJoint)
    geometry, data = plant.geometry("collision"), plant.model.createData()
    placed = geometry.createData()
    pin.updateGeometryPlacements(plant.model, data, geometry, placed, q)
    deepest = -6.0
    for body in bodies:
        there = pose * body.pose
        far = coal.Transform3s(there.rotation, there.translation)
        allowed = DEEP if body.grasp is None else IN_NOZZLE
        for item, at in zip(geometry.geometryObjects, placed.oMg, strict=True):
            if int(item.parentJoint) == without or np.linalg.norm(at.translation - there.translation) > 6.0:
                continue
            near = coal.Transform3s(at.rotation, at.translation)
            asked = coal.DistanceRequest(), coal.DistanceResult()
            inside = -float(coal.distance(item.geometry, near, body.shape, far, *asked)) - allowed
            if body.grasp is not None and int(item.parentJoint) == hand:
                inside -= force / BENDING
            deepest = max(deepest, inside)
    return deepest


def overlap(outcome: Any) -> float:
    """Return the largest depth [m] of a servicer's shape in a client's body during a flight."""
    found, plant, whole = outcome.capture, outcome.plant, outcome.capture.whole
    hand = int(plant.model.frames[plant.frame_id].parentJoint)
    bodies = rendezvous(outcome.scenario, outcome.sms).bodies()
    latched = found.latched_at if found.caught else np.inf
    dt, k, deepest = float(whole.t[1] - whole.t[0]), 0, 0.0
    while k < len(whole.t):
        pose, without = pin.XYZQUATToSE3(whole.client_pose[k]), hand if whole.t[k] > latched - 1e-9 else -1
        force = float(np.linalg.norm(whole.contact_wrench[k, :3]))
        deep = depth(plant, whole.q[k], pose, bodies, force, without)
        deepest = max(deepest, deep)
        k += max(1, round(max(STEP, -deep / APPROACH) / dt))
    return deepest


def begins_clear(text: str) -> bool:
    """Return whether the client of a scenario file is more than 0.1 m from the servicer at the start."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.toml"
        path.write_text(text, encoding="utf-8")
        scenario = scenarios.scenario(path)
        sms = scenario.load()
        meeting = rendezvous(scenario, sms)
        return depth(sms, meeting.q0, meeting.client.pose(0.0), meeting.bodies()) < -0.1


def flown(kind: str, seed: int) -> dict[str, Any]:
    """Simulate a run, and return its outcome."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{kind}.toml"
        path.write_text(scenario_text(kind, seed), encoding="utf-8")
        try:
            outcome = scenarios.run(scenarios.scenario(path))
        except FfsmsError as error:
            return {"caught": False, "why": str(error), "refused": True}
    found = outcome.capture
    assert found is not None
    whole, limits = found.whole, outcome.plant.limits
    joints = np.array([outcome.plant.layout.positions(q) for q in whole.q])
    beyond = float(np.maximum(limits.lower - joints, joints - limits.upper).max())
    fast = float((np.abs(whole.v[:, 6:]) / limits.velocity).max())
    last = float(np.abs(whole.v[-1, 6:]).max())
    # A run that collides ends there.
    rests = last <= RESTS or found.phases[-1].name == "collision"
    deep = overlap(outcome)
    row: dict[str, Any] = {
        "caught": found.caught,
        "why": found.missed,
        "stopped": whole.stopped,
        "note": "" if whole.arrived else (whole.misses or ("",))[0],
        "force": float(np.linalg.norm(whole.contact_wrench[:, :3], axis=1).max()),
        "fast": fast,
        "beyond": beyond,
        "lost": bool(fast > FAST or beyond > BEYOND or not rests),
        "overlap": deep,
        "untold": bool(deep > 0.0 and not re.search(r"overlap|touch", whole.note)),
    }
    if found.caught and found.expected is not None and not found.held:
        end = float(whole.t[-1]) - found.contact_at
        deviation = found.expected.deviation(end)
        if (deviation > 0.0).all():
            row["z"] = ((found.found_rate - found.expected.rate(end)) / deviation).tolist()
    return row


def estimated(seed: int) -> dict[str, Any]:
    """Return the difference of the base's rate from an estimate's prediction, in standard deviations."""
    text = scenario_text("right", seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "right.toml"
        path.write_text(text, encoding="utf-8")
        scenario = scenarios.scenario(path)
    sms = scenario.load()
    meeting, rng = rendezvous(scenario, sms), np.random.default_rng((seed, 1))
    client, estimate, camera = meeting.client, meeting.first_estimate(), meeting.camera
    assert isinstance(estimate, ClientEstimate)
    assert camera is not None
    believed, contact = estimate.client(), meeting.duration
    for t in np.arange(camera.period, contact - 1.0 - camera.latency, camera.period):
        estimate.observe(measured(client, float(t), camera, rng, believed), float(t))
    joints = scenario.client["joints"]
    q = straight_end(sms, meeting.q0, np.array(joints), contact, None)
    rates, deviation = [], np.zeros(3)
    for body in (estimate, client):
        prediction = predicted(sms, q, np.zeros(sms.nv), body, contact)
        rates.append(prediction.rate(AFTER))
        deviation = np.maximum(deviation, prediction.deviation(AFTER))
    return {"z": ((rates[1] - rates[0]) / deviation).tolist()}


def table(rows: list[dict[str, Any]]) -> str:
    """Return a Markdown table with a row for each kind, and a line for each run without a catch."""
    head = (
        "runs",
        "caught",
        "control lost",
        "missed without a reason",
        "unreported overlaps",
        "largest force [N]",
    )
    shown, lines = [], []
    for kind in KINDS:
        some = [row for row in rows if row["kind"] == kind and "caught" in row]
        if not some:
            continue
        missed = [row for row in some if not row["caught"]]
        shown.append(
            (
                f"{kind}: {len(some)}",
                str(len(some) - len(missed)),
                str(sum(row.get("lost", False) for row in some)),
                str(sum(not row["why"] for row in missed)),
                str(sum(row.get("untold", False) for row in some)),
                f"{max(row.get('force', 0.0) for row in some):.3g}",
            )
        )
        lines += [f"* {kind}, seed {row['seed']}: {row['why'].partition(';')[0][:160]}" for row in missed]
    intervals = []
    for kind in KINDS:
        z = np.array([row["z"] for row in rows if row["kind"] == kind and "z" in row])
        if len(z):
            shares = [100.0 * float((np.abs(z) <= m).mean()) for m in (1.0, 2.0, 3.0)]
            error = 100.0 * np.sqrt(0.6827 * 0.3173 / len(z))  # the three axes of a run depend on each other
            intervals.append((f"{kind}: {len(z)}", *(f"{one:.1f} %" for one in shares), f"{error:.1f} %"))
    found = markdown(head, shown)
    if intervals:
        words = ("runs", "within 1", "2", "3 standard deviations", "sampling error of the first")
        found += "\n\n" + markdown(words, intervals)
    return found + "\n\nNot caught:\n\n" + "\n".join(lines) if lines else found


def main() -> None:
    """Print a line for each run as it ends, and a table of all runs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kinds", nargs="*", metavar="KIND")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--resume", type=Path, help="file of the runs so far")
    arguments = parser.parse_args()
    if unknown := set(arguments.kinds) - set(KINDS):
        parser.error(f"KIND must be among {', '.join(KINDS)}, got {', '.join(sorted(unknown))}")
    # Skip the simulation of the first plan without re-planning.
    mock.patch.object(closed_loop, "attempt", return_value=None).start()
    kept = arguments.resume
    lines = kept.read_text("utf-8").splitlines() if kept is not None and kept.exists() else []
    rows = [json.loads(line) for line in lines]
    before = {(row["kind"], row["seed"]) for row in rows}
    for kind in arguments.kinds:
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            if (kind, seed) in before:
                continue
            result = estimated(seed) if kind == "estimate" else flown(kind, seed)
            rows.append(row := {"kind": kind, "seed": seed, **result})
            if kept is not None:
                with kept.open("a", encoding="utf-8") as file:
                    file.write(f"{json.dumps(row)}\n")
            words = {name: value for name, value in row.items() if name not in ("kind", "seed", "why")}
            print(f"{kind} {seed}: {words} {row.get('why', '')[:300]}", file=sys.stderr, flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
