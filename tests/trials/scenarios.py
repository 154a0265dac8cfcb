"""Read and run damaged scenario files."""

from __future__ import annotations

import random
import re
from pathlib import Path

from ffsms_pin.scenarios import run, scenario
from ffsms_pin.scenarios.closed_loop import prepared
from trials.judge import Trial

__all__ = ["trial"]

# A scenario with all tables, whose run takes a few hundredths of a second.
WHOLE = """
[robot]
model = "planar_3r"
end_effector = "end_effector"
base_size = [0.4, 0.4, 0.4]
[start]
joints_deg = [23.0, 40.0, -29.0]
[target]
position = [0.85, 0.45, 0.0]
[plan]
duration = 0.4
dt = 0.1
kappa = 10.0
clearance = 0.01
collision = "points"
method = "step"
reach = 0.02
momentum = [0.0, 0.0, 0.0, 0.0, 0.0, 0.01]
[plan.base_limits]
attitude_deg = 20.0
translation = 0.5
[limits]
lower_deg = -80.0
upper_deg = 80.0
velocity = 0.4
acceleration = [0.5, 0.5, 0.5]
torque = 3.0
[control]
law = "computed-torque"
K_p = 25.0
K_d = [10.0, 10.0, 10.0]
torque_limit = 3.0
dt = 0.02
offset_deg = [0.5, 0.0, -0.5]
[reference]
kind = "plan"
hold = 0.1
[simulation]
integrator = "rk4"
[plant]
arm_mass = 1.1
base_mass = 0.9
arm_com = [0.001, 0.0, 0.0]
[plant.random]
seed = 1
arm_mass = 0.1
[friction]
viscous = 0.01
coulomb = 0.01
transition_deg = 0.6
[actuator]
torque_limit = 3.0
rate_limit = 100.0
delay = 0.02
[sensors]
joint_noise_deg = 0.01
base_rate_noise = 1e-4
base_latency = 0.04
seed = 3
[[disturbance]]
wrench = [0.1, 0.0, 0.0, 0.0, 0.0, 0.01]
on = "base"
start = 0.1
end = 0.2
[[capture]]
time = 0.2
mass = 2.0
inertia = [0.1, 0.1, 0.1]
com = [0.1, 0.0, 0.0]
[[fault]]
time = 0.3
joint = "joint_2"
kind = "locked"
[guards]
position_margin = 0.1
joint_error_deg = 60.0
failed_steps = 5
path = "stopped.npz"
"""
REPLANNED = WHOLE.replace('kind = "plan"', 'kind = "re-planning"\ndt = 0.1')

# Extreme values are above 1e12 or below 1e-12, because durations between them may be valid and take long.
VALUES = (
    "0", "-0.0", "1", "-1", "0.5", "1e-300", "1e-30", "1e-13", "1e13", "1e30", "3e71", "1e300", "-1e30",
    "nan", "inf", "-inf", "9" * 30, "9" * 5000, "true", "false", '""', '"x"', '"nan"', '"planar_3r"',
    '"space_arm_7"', '"locked"', '"stiff"', '"variational"', '"horizon"', '"shapes"', "[]", "[1]",
    "[1, 2]", "[0.1, 0.2, 0.3]", "[nan, 0, 0]", "[1e30, 1e30, 1e30]", "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]",
    "[[1, 2], [3]]", '["a", "b", "c"]', "[[[1]]]", "{}", "{ a = 1 }", "1979-05-27", "0x1F", "1_000",
    "'''a\nb'''", '"\\u0000"',
)  # fmt: skip

NUMBERS = (
    "0.0", "1.0", "-1.0", "0.3", "-0.2", "2.0", "7.5", "100.0", "1e-12", "1e-9", "1e-6", "1e-3", "1e3",
    "1e6", "1e9", "1e12", "1e30", "nan", "inf",
)  # fmt: skip
_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")


def trial(seed: int) -> Trial:
    """Return the trial of a seed: write, read and prepare a file, and run it if the run is short."""
    rng = random.Random(f"scenario {seed}")
    text = rng.choice((WHOLE, REPLANNED))
    for _ in range(rng.randint(0, 12)):  # with fewer tables, later tables are reached
        text = _without_a_table(rng, text)
    damages = []
    for _ in range(rng.choice((1, 1, 1, 2))):
        damage = rng.choice((_number, _number, _number, _number, _number, _value, _key, _line, _signs))
        text, description = damage(rng, text)
        damages.append(description)
    return Trial("; ".join(damages)[:300], lambda: _use(text))


def _use(text: str) -> None:
    path = Path("damaged.toml")
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    chosen = scenario(path)
    sms = chosen.load()
    with chosen.named():
        prepared(chosen, sms, chosen.start_configuration(sms))
    planned = chosen.arrival / float(chosen.plan.get("dt", 0.01))
    if chosen.duration / chosen.control.get("dt", 1e-3) <= 2_000 and planned <= 100:
        run(chosen)


def _number(rng: random.Random, text: str) -> tuple[str, str]:
    """Replace a number by another that may be out of range; most files remain readable."""
    lines = text.splitlines()
    places = [(i, place) for i, line in enumerate(lines) for place in _NUMBER.finditer(line)]
    if not places:
        return text, "no number left"
    i, place = rng.choice(places)
    lines[i] = lines[i][: place.start()] + rng.choice(NUMBERS) + lines[i][place.end() :]
    return "\n".join(lines), lines[i][:80]


def _value(rng: random.Random, text: str) -> tuple[str, str]:
    """Replace the value of a key, or an entry of a list."""
    lines = text.splitlines()
    i = rng.choice([k for k, line in enumerate(lines) if "=" in line])
    key, _, old = lines[i].partition("=")
    new = rng.choice(VALUES)
    if old.strip().startswith("[") and rng.random() < 0.4:
        entries = old.strip()[1:-1].split(",")
        entries[rng.randrange(len(entries))] = new
        new = f"[{', '.join(entries)}]"
    lines[i] = f"{key}= {new}"
    return "\n".join(lines), lines[i][:80]


def _key(rng: random.Random, text: str) -> tuple[str, str]:
    """Misspell a key, or copy its line to another position."""
    lines = text.splitlines()
    i, k = (rng.choice([k for k, line in enumerate(lines) if "=" in line]) for _ in range(2))
    if rng.random() < 0.5:
        lines[i] = lines[i][:1] + lines[i]
    else:
        lines.insert(k, lines[i])
    return "\n".join(lines), f"misplaced {lines[i][:60]}"


def _line(rng: random.Random, text: str) -> tuple[str, str]:
    """Drop a line, or exchange two lines."""
    lines = text.splitlines()
    i, k = rng.randrange(len(lines)), rng.randrange(len(lines))
    if rng.random() < 0.5:
        return "\n".join(lines[:i] + lines[i + 1 :]), f"without {lines[i][:60]}"
    lines[i], lines[k] = lines[k], lines[i]
    return "\n".join(lines), f"exchanged {lines[i][:40]} and {lines[k][:40]}"


def _signs(rng: random.Random, text: str) -> tuple[str, str]:
    """Replace or drop a character."""
    i = rng.randrange(len(text))
    sign = rng.choice(("", "[", "]", '"', "=", "\n", "\0", "#", ".", "\ud800", "e9", "-", "]]"))
    return text[:i] + sign + text[i + 1 :], f"sign {i} became {sign!r}"


def _without_a_table(rng: random.Random, text: str) -> str:
    """Remove an optional table."""
    parts = text.split("\n[")
    needed = ("robot", "start", "target", "plan]")
    free = [i for i in range(1, len(parts)) if not parts[i].startswith(needed)]
    if free:
        del parts[rng.choice(free)]
    return "\n[".join(parts)
