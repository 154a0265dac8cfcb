"""Draw random MJCF files with frames, includes, defaults, several joints per body, Euler orders and flags."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

import numpy as np


def formatted(numbers: Any) -> str:
    return " ".join(f"{x:.9g}" for x in np.ravel(numbers))


class _Drawn:
    """The random choices of one file."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.numbers = rng, count()
        self.degrees = bool(rng.random() < 0.5)
        self.sequence = "".join(rng.choice(list("xyzXYZ"), 3))
        self.from_geoms = str(rng.choice(["auto", "true", "false"], p=[0.7, 0.15, 0.15]))
        self.groups = rng.random() < 0.2
        self.joints = 0

    def some(self, chance: float) -> bool:
        return bool(self.rng.random() < chance)

    def angle(self, size: float = 3.0) -> float:
        value = float(self.rng.uniform(-size, size))
        return float(np.degrees(value)) if self.degrees else value

    def turn(self) -> str:
        kind = self.rng.integers(6)
        if kind == 0:
            return f'quat="{formatted(self.rng.normal(size=4))}"'
        if kind == 1:
            return f'axisangle="{formatted(self.rng.normal(size=3))} {self.angle():.9g}"'
        if kind == 2:
            return f'euler="{formatted([self.angle() for _ in range(3)])}"'
        if kind == 3:
            return f'xyaxes="{formatted(self.rng.normal(size=6))}"'
        if kind == 4:
            return f'zaxis="{formatted(self.rng.normal(size=3))}"'
        return ""

    def place(self) -> str:
        return f'pos="{formatted(self.rng.uniform(-0.5, 0.5, 3))}" {self.turn()}'

    def joint(self) -> str:
        self.joints += 1
        turns = self.some(0.7)
        ref = self.angle(1.0) if turns else float(self.rng.uniform(-0.3, 0.3))
        parts = [f'name="j{next(self.numbers)}"', f'type="{"hinge" if turns else "slide"}"']
        parts.append(f'axis="{formatted(self.rng.normal(size=3))}"')
        if self.some(0.5):
            parts.append(f'pos="{formatted(self.rng.uniform(-0.2, 0.2, 3))}"')
        if self.some(0.3):
            parts.append(f'ref="{ref:.9g}"')
        if self.some(0.4):
            parts.append(f'armature="{self.rng.uniform(0.0, 0.4):.9g}"')
        if self.some(0.3):
            parts.append(f'damping="{self.rng.uniform(0.0, 2.0):.9g}"')
        if self.some(0.2):
            parts.append('class="heavy"')
        return f"<joint {' '.join(parts)}/>"

    def inertial(self) -> str:
        mass, moments = self.rng.uniform(0.3, 8.0), self.rng.uniform(0.01, 0.3, 3)
        a, b, c = moments[1] + moments[2], moments[0] + moments[2], moments[0] + moments[1]
        if self.some(0.4):
            turn = np.linalg.qr(self.rng.normal(size=(3, 3)))[0]
            t = turn @ np.diag([a, b, c]) @ turn.T
            tensor = f'fullinertia="{formatted([t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2]])}"'
            place = f'pos="{formatted(self.rng.uniform(-0.3, 0.3, 3))}"'
        else:
            tensor, place = f'diaginertia="{formatted([a, b, c])}"', self.place()
        return f'<inertial mass="{mass:.9g}" {place} {tensor}/>'

    def geom(self) -> str:
        kind = str(self.rng.choice(["sphere", "capsule", "cylinder", "box", "ellipsoid"]))
        number = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}[kind]
        parts = [f'type="{kind}"', f'size="{formatted(self.rng.uniform(0.05, 0.3, number))}"', self.place()]
        if kind in ("capsule", "cylinder") and self.some(0.4):
            parts[1:] = [f'size="{self.rng.uniform(0.05, 0.2):.9g}"']
            parts.append(f'fromto="{formatted(self.rng.uniform(-0.5, 0.5, 6))}"')
        chance = self.rng.random()
        if chance < 0.3:
            parts.append(f'mass="{self.rng.uniform(0.1, 4.0):.9g}"')
        elif chance < 0.6:
            parts.append(f'density="{self.rng.uniform(200.0, 3000.0):.9g}"')
        if self.some(0.2):
            parts.append('shellinertia="true"')
        if self.some(0.3):
            parts.append('class="light"')
        group = 1 if self.groups and self.some(0.3) else 0
        parts.append(f'group="{group}"')
        return f"<geom {' '.join(parts)}/>"

    def body(self, depth: int, moves: bool) -> str:
        name, inside = f"b{next(self.numbers)}", list[str]()
        for _ in range(int(self.rng.choice([1, 2, 3], p=[0.75, 0.18, 0.07])) if moves else 0):
            inside.append(self.joint())
        if self.from_geoms == "false" or self.some(0.5):
            inside.append(self.inertial())
        inside.append(self.geom().replace('group="1"', 'group="0"'))  # every body has a mass
        if self.some(0.3):
            inside.append(self.geom())
        if self.some(0.3):
            inside.append(f'<site name="s{next(self.numbers)}" {self.place()}/>')
        for _ in range(int(self.rng.integers(0, 3)) if depth else 1):
            if depth < 4 and self.joints < 8:
                inner = self.body(depth + 1, moves=self.some(0.8) or not self.joints)
                inside.append(f"<frame {self.place()}>{inner}</frame>" if self.some(0.3) else inner)
        label = f' childclass="{self.rng.choice(["light", "heavy"])}"' if self.some(0.2) else ""
        return f'<body name="{name}"{label} {self.place()}>{"".join(inside)}</body>'


def draw(folder: Path, seed: int, floating: bool) -> Path:
    """Write a random file, which may include a second one, and return its path."""
    drawn = _Drawn(np.random.default_rng(seed))
    tree = drawn.body(0, moves=False if floating else drawn.some(0.5))
    if floating:
        at = tree.index(">") + 1
        tree = f"{tree[:at]}<freejoint/>{tree[at:]}"
    flags = [f'angle="{"degree" if drawn.degrees else "radian"}"', f'eulerseq="{drawn.sequence}"']
    flags.append(f'inertiafromgeom="{drawn.from_geoms}"')
    if drawn.groups:
        flags.append('inertiagrouprange="0 0"')
    if drawn.some(0.2):
        flags.append(f'settotalmass="{drawn.rng.uniform(5.0, 50.0):.9g}"')
    if drawn.some(0.2):
        flags.append('boundmass="0.5" boundinertia="0.02"')
    if drawn.some(0.2):
        flags.append('fusestatic="true"')
    if drawn.some(0.2):
        flags.append('discardvisual="true"')
    default = (
        '<default><geom density="800"/><default class="light"><geom density="300"/><joint armature="0.05"/>'
        '</default><default class="heavy"><joint armature="0.3" damping="1"/></default></default>'
    )
    if drawn.some(0.3):
        (folder / "arm.xml").write_text(f"<mujocoinclude>{tree}</mujocoinclude>")
        tree = '<include file="arm.xml"/>'
    if not floating and drawn.some(0.3):
        tree = f"<frame {drawn.place()}>{tree}</frame>"
    path = folder / "drawn.xml"
    text = (
        f'<mujoco model="drawn"><compiler {" ".join(flags)}/>{default}<worldbody>{tree}</worldbody></mujoco>'
    )
    path.write_text(text)
    return path
