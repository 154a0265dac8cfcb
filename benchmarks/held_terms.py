"""Measure the benefit of the cost terms for wheels and propellant, on Case 2 with the base held.

Run: python benchmarks/held_terms.py. The wheels are the small ones of `wheels.py`; twelve thrusters with
proportional force are at the midpoints of a cube's edges.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from table import markdown
from wheels import SMALL

import ffsms_pin as ffsms
from ffsms_pin import opt

TARGET, DURATION = [0.45, 0.65, 0.0], 12.0  # [m], [s] as in Case 2
HALF, FORCE = 0.5, 50.0  # [m] half of the cube's side, [N] largest force of a thruster
HELD: dict[str, tuple[str, tuple[opt.WheelMomentum | opt.WheelEnergy | opt.Propellant, ...]]] = {
    "rotation-floating": (
        "attitude, by wheels",
        (opt.WheelMomentum(1.0), opt.WheelEnergy(0.01), opt.WheelEnergy(0.1)),
    ),
    "rotation-flying": ("attitude, by thrusters", (opt.Propellant(0.1),)),
    "translation-flying": ("position, by thrusters", (opt.Propellant(0.1),)),
    "flying": ("attitude and position, by thrusters", (opt.Propellant(0.1),)),
}


def thrusters() -> ffsms.Thrusters:
    """Return two thrusters on each face of the cube, which push inwards."""
    places, ways = [], []
    for axis, side, beside in product(range(3), (1.0, -1.0), (1.0, -1.0)):
        places.append(np.roll([HALF * side, HALF * beside, 0.0], axis))
        ways.append(np.roll([-side, 0.0, 0.0], axis))
    return ffsms.Thrusters(places, ways, FORCE, proportional=True)


def line(label: str, plan: opt.Trajectory, term: str) -> tuple[str, ...]:
    """Return one line of the table."""
    by_wheels = plan.wheel_momentum.size > 0
    return (
        label,
        term,
        f"{np.abs(plan.wheel_momentum).max():.2g} N m s" if by_wheels else "",
        f"{plan.wheel_energy:.2g} J" if by_wheels else "",
        "" if by_wheels else f"{1e3 * plan.propellant:.2g} g",
        f"{plan.cost_integral:.1g}" if plan.reached else "not reached",
    )


def main() -> None:
    """Print the table."""
    bare, lines = ffsms.load("planar_3r"), []
    q0 = bare.configuration(np.radians([1.0, 1.0, 1.0]))
    for mode, (label, terms) in HELD.items():
        actuators = {"wheels": SMALL} if "wheels" in label else {"thrusters": thrusters()}
        problem = opt.Problem(bare.with_actuators(**actuators), q0, TARGET, DURATION, mode=mode)
        lines.append(line(label, opt.solve(problem), "none"))
        for term in terms:
            plan = opt.solve(replace(problem, terms=(*problem.terms, term)))
            lines.append(line("", plan, f"`{type(term).__name__}({term.weight:g})`"))
    print(
        markdown(
            ("held", "term", "largest wheel momentum", "energy", "propellant", "the paper's cost [s]"), lines
        )
    )


if __name__ == "__main__":
    main()
