"""Draw random URDF files with branches, fixed joints, all kinds of joints and products of inertia."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["DrawnUrdf", "draw"]


def formatted(numbers: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(numbers))


@dataclass
class DrawnUrdf:
    """A random file, and the limits and dynamics in it.

    Attributes
    ----------
    text : str
    tip : str
        The name of a link without children.
    limits, dynamics : dict
        Lower, upper, velocity and effort, and damping and friction, of each moving joint.
    """

    text: str = ""
    tip: str = ""
    limits: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    dynamics: dict[str, tuple[float, float]] = field(default_factory=dict)


def draw(seed: int) -> DrawnUrdf:
    """Return the random robot of a seed, with two to nine joints, at least one of which moves."""
    rng, drawn = np.random.default_rng(seed), DrawnUrdf()
    count = int(rng.integers(2, 10))
    parts, leaves = [_link(rng, 0, moves=True)], {0}
    kinds = rng.choice(["revolute", "continuous", "prismatic", "fixed"], count, p=[0.4, 0.2, 0.2, 0.2])
    kinds[0] = "revolute" if (kinds == "fixed").all() else kinds[0]
    for k, kind in enumerate(kinds, start=1):
        parent = int(rng.integers(0, k)) if rng.random() < 0.25 else k - 1
        leaves = (leaves - {parent}) | {k}
        parts += [_link(rng, k, moves=kind != "fixed"), _joint(rng, drawn, k, parent, str(kind))]
    drawn.tip = f"l{min(leaves)}"
    order = rng.permutation(len(parts)) if rng.random() < 0.3 else range(len(parts))
    drawn.text = f'<robot name="drawn">{"".join(parts[i] for i in order)}</robot>'
    return drawn


def _origin(rng: np.random.Generator, size: float) -> str:
    if rng.random() < 0.15:
        return ""
    turn = rng.uniform(-3.0, 3.0, 3) * (rng.random() < 0.8)
    return f'<origin xyz="{formatted(rng.uniform(-size, size, 3))}" rpy="{formatted(turn)}"/>'


def _link(rng: np.random.Generator, k: int, moves: bool) -> str:
    if not moves and rng.random() < 0.4:
        return f'<link name="l{k}"/>'
    mass = float(rng.uniform(0.1, 20.0)) + (200.0 if k == 0 else 0.0)
    masses, turn = rng.uniform(0.01, 0.3, 3), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tensor = mass * turn @ np.diag(masses.sum() - masses) @ turn.T
    entries = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), tensor[np.triu_indices(3)], strict=True)
    inertia = " ".join(f'{name}="{float(value)!r}"' for name, value in entries)
    body = f'{_origin(rng, 0.3)}<mass value="{mass!r}"/><inertia {inertia}/>'
    return f'<link name="l{k}"><inertial>{body}</inertial></link>'


def _joint(rng: np.random.Generator, drawn: DrawnUrdf, k: int, parent: int, kind: str) -> str:
    name, inside = f"j{k}", [f'<parent link="l{parent}"/><child link="l{k}"/>', _origin(rng, 0.6)]
    if kind != "fixed":
        axis = rng.normal(size=3) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)] * rng.choice([-1, 1])
        lower, upper, velocity, effort = -rng.uniform(0.1, 3.0), *rng.uniform(0.1, 3.0, 3)
        bounds = "" if kind == "continuous" else f'lower="{float(lower)!r}" upper="{float(upper)!r}" '
        inside.append(f'<axis xyz="{formatted(axis)}"/>')
        inside.append(f'<limit {bounds}velocity="{float(velocity)!r}" effort="{float(effort)!r}"/>')
        if kind == "continuous":
            lower, upper = -np.inf, np.inf
        drawn.limits[name] = (float(lower), float(upper), float(velocity), float(effort))
        damping, friction = (float(x) for x in rng.uniform(0.0, 2.0, 2) * (rng.random(2) < 0.5))
        drawn.dynamics[name] = damping, friction
        values = [("damping", damping), ("friction", friction)]
        written = " ".join(f'{key}="{value!r}"' for key, value in values if value)
        inside += [f"<dynamics {written}/>"] if written else []
    return f'<joint name="{name}" type="{kind}">{"".join(inside)}</joint>'
