"""Read and use damaged and hostile robot descriptions."""

from __future__ import annotations

import random
import re
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import control, inspection, opt
from ffsms_pin.geometry.shapes import Description
from ffsms_pin.robot import satellite_names
from ffsms_pin.urdf import model_path
from trials.judge import Trial

__all__ = ["trial"]

NUMBERS = (
    "0", "-0.0", "-1", "nan", "inf", "-inf", "1e400", "1e300", "1e31", "1e30", "1e15", "1e12", "1e-12",
    "0.5", "3.7", "100", "1e-3", "1e-6", "1e-9", "1e6", "1e9", "1e-30", "1e-160", "1e-320", "0x10",
    "1,5", "", "9" * 400, "\u0663",
)  # fmt: skip
TOKENS = (
    "<",
    ">",
    "/>",
    "</robot>",
    "&",
    "&amp;",
    '"',
    "\0",
    "<!--",
    "]]>",
    "<link/>",
    "&x;",
    "\ufeff",
    "\ud800",
)
_SCALE = re.compile(r'(?:mass value|velocity|effort|lower|upper)="([-+.\deE]+)"')
_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:[eE][+-]?\d+)?(?![\w.])")


def trial(seed: int) -> Trial:
    """Return the trial of a seed: write, read and use a file."""
    rng = random.Random(f"urdf {seed}")
    damage = rng.choice((_numbers, _numbers, _scales, _scales, _text, _structure, _structure, _hostile))
    name, text, tool = rng.choice(_sources())
    content = damage(rng, text).encode("utf-8", "surrogatepass")
    mounted = rng.random() < 0.2
    what = f"{damage.__name__.strip('_')} of {name}{', mounted' if mounted else ''}"
    named = tool if rng.random() < 0.9 else None
    return Trial(what, lambda: _use(content, mounted, named))


def _use(content: bytes, mounted: bool, tool: str | None) -> None:
    """Read a file, and use the robot for states, a simulation, shapes and a plan."""
    path = Path("damaged.urdf")
    path.write_bytes(content)
    inspection.inspect(path)
    sms = (ffsms.mount if mounted else ffsms.load)(path, end_effector=tool)
    start = np.clip(np.full(sms.n, 0.1), sms.limits.lower, sms.limits.upper)
    q = sms.configuration(start)
    state = sms.at(q, sms.velocity(q, np.full(sms.n, 1e-3)))
    for name in dir(type(state)):
        if not name.startswith("_"):
            getattr(state, name)
    ffsms.simulate(sms, _Standing(sms, start), control.PD(sms), dt=1e-3)
    sms.geometry("collision")
    near = state.end_effector_pose.translation + 1e-3
    if np.isfinite(sms.limits.velocity).all() and not sms.limits.violation(start).any():
        opt.plan(sms, q, near, duration=0.2, dt=0.1, method="step")


class _Standing:
    """A reference with constant joint positions for a few steps."""

    duration = 5e-3
    target = (1.0, 0.0, 0.0)

    def __init__(self, sms: ffsms.SpaceManipulator, positions: Any) -> None:
        self.q = sms.configuration(positions)[np.newaxis]
        self._sample = positions, np.zeros(sms.n), np.zeros(sms.n)

    def sample(self, t: float) -> Any:
        """Return the constant joint motion."""
        return self._sample


@cache
def _sources() -> list[tuple[str, str, str]]:
    """Return name, text and end effector of packaged robots, some repeated, and of arms on a satellite."""
    small = [(name, model_path(name).read_text(), "end_effector") for name in ("planar_3r", "space_arm_7")]
    double = [("two_arms", model_path("two_arms").read_text(), "left_tool")]
    mounted = []
    for name in satellite_names():
        sms = ffsms.load(name)
        assert isinstance(sms.description, Description)
        mounted.append((name, sms.description.text, sms.end_effector))
    return [*(3 * small), *double, *mounted]


def _numbers(rng: random.Random, text: str) -> str:
    """Replace one to four numbers."""
    for _ in range(rng.randint(1, 4)):
        places = list(_NUMBER.finditer(text))
        if not places:
            break
        place = rng.choice(places)
        text = text[: place.start()] + rng.choice(NUMBERS) + text[place.end() :]
    return text


def _scales(rng: random.Random, text: str) -> str:
    """Change the order of magnitude of masses and limits; most of these files remain readable."""
    for _ in range(rng.randint(1, 4)):
        places = list(_SCALE.finditer(text))
        place = rng.choice(places)
        factor = 10.0 ** rng.choice((-30, -15, -12, -9, -6, -3, -1, 1, 3, 6, 9, 12, 15, 30))
        text = text[: place.start(1)] + repr(float(place[1]) * factor) + text[place.end(1) :]
    return text


def _text(rng: random.Random, text: str) -> str:
    """Drop, double, reverse or insert characters, or cut off the end."""
    for _ in range(rng.randint(1, 4)):
        i, k = sorted(rng.sample(range(len(text)), 2))
        k = min(k, i + rng.randint(1, 40))
        choice = rng.randrange(5)
        if choice == 0:
            text = text[:i] + text[k:]
        elif choice == 1:
            text = text[:k] + text[i:k] + text[k:]
        elif choice == 2:
            text = text[:i] + rng.choice(TOKENS) + text[i:]
        elif choice == 3:
            text = text[:i] + text[i:k][::-1] + text[k:]
        elif rng.random() < 0.2:
            text = text[: max(i, 2)]
    return text


def _structure(rng: random.Random, text: str) -> str:
    """Drop, double, move or exchange elements and attributes."""
    root = ElementTree.fromstring(text)
    for _ in range(rng.randint(1, 3)):
        parents = {child: parent for parent in root.iter() for child in parent}
        if not parents:
            break
        element, other = rng.choice(list(parents)), rng.choice(list(parents))
        choice = rng.randrange(6)
        if choice == 0:
            parents[element].remove(element)
        elif choice == 1:
            parents[element].append(element)
        elif choice == 2:
            element.attrib, other.attrib = other.attrib, element.attrib
        elif choice == 3 and element.attrib:
            element.set(
                rng.choice(sorted(element.attrib)), rng.choice((*NUMBERS, "base", "floating", "continuous"))
            )
        elif choice == 4:
            element.tag = other.tag
        elif choice == 5 and element not in other.iter() and other not in element.iter():
            parents[element].remove(element)
            other.append(element)
    return ElementTree.tostring(root, encoding="unicode")


def _hostile(rng: random.Random, text: str) -> str:
    """Return a hostile file with nested tags, entities, many links, long chains or long names."""
    depth = rng.choice((300, 3_000, 30_000))
    tag = rng.choice(("a", "link", "robot", "visual"))
    nested = f"<{tag}>" * depth + f"</{tag}>" * depth
    lol = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
    body = text.split("?>", 1)[-1]
    wide = "".join(f'<link name="w{i}"/>' for i in range(depth))
    chain = "".join(
        f'<link name="c{i + 1}"/><joint name="c{i}" type="fixed">'
        f'<parent link="c{i}"/><child link="c{i + 1}"/></joint>'
        for i in range(depth // 10)
    )
    tree = f'<robot name="chain"><link name="c0"/>{chain}</robot>'
    return rng.choice(
        [
            text.replace("</robot>", nested + "</robot>"),
            text.replace("<inertial>", f"<inertial>{nested}", 1),
            nested,
            f'<!DOCTYPE robot [<!ENTITY a0 "lol">{lol}]>{body.replace("<inertial>", "&a9;<inertial>", 1)}',
            '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>'
            + body.replace("<inertial>", "&x;<inertial>", 1),
            text.replace("</robot>", wide + "</robot>"),
            tree,
            text.replace('name="', f'name="{"n" * 100_000}', 1),
            text.encode("utf-16").decode("latin-1"),
        ]
    )
