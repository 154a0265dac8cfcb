"""Measure the drift of the integrators over an hour of free flight, and print a Markdown table.

Run from the repository's root: python benchmarks/integrators.py [--hours 1] [--robot planar_3r]
The robot tumbles and its joints move without torque and friction. Energy and momentum should be constant.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.simulation.integrators import INTEGRATORS

# Steps [s] at which the relative change of the momentum in an hour is below 1e-10, for each integrator. The
# variational integrator reaches this only if the centre of mass is at rest, see docs/closed-loop.md.
STEPS = {"rk4": (0.005,), "adaptive": (1.0,)}


def free_flight(name: str, sms: Any, duration: float, dt: float) -> dict[str, float]:
    """Return the largest drifts in a free flight, evaluated at a hundred instants."""
    rng = np.random.default_rng(5)
    q = sms.configuration(rng.uniform(-0.5, 0.5, sms.n))
    # The robot tumbles and its joints move at about 0.02 rad/s; the centre of mass drifts at about 1 cm/s.
    spin = 0.02 * sms.at(q).H_b[3:, 3:] @ rng.normal(size=3)
    push = 0.01 * pin.computeTotalMass(sms.model) * rng.normal(size=3)
    v = sms.velocity(q, 0.02 * rng.normal(size=sms.n), np.concatenate([push, spin]))
    model, data, tau = sms.model, sms.model.createData(), np.zeros(sms.nv)
    own = model.createData()

    def momentum() -> Any:
        return pin.computeCentroidalMomentum(model, own, q, v).vector

    first, energy = momentum(), pin.computeKineticEnergy(model, own, q, v)
    linear, angular = np.linalg.norm(first[:3]), np.linalg.norm(first[3:])
    worst = dict.fromkeys(("linear", "angular", "energy", "quaternion"), 0.0)
    steps = round(duration / dt)
    stride = max(1, steps // 100)
    begin = time.perf_counter()
    for k in range(steps):
        q, v, _ = INTEGRATORS[name](model, data, q, v, tau, dt)
        if (k + 1) % stride == 0:
            h = momentum() - first
            drift = pin.computeKineticEnergy(model, own, q, v) - energy
            now = {
                "linear": np.linalg.norm(h[:3]) / linear,
                "angular": np.linalg.norm(h[3:]) / angular,
                "energy": abs(drift) / energy,
                "quaternion": abs(np.linalg.norm(q[3:7]) - 1.0),
            }
            # NumPy's maximum keeps NaN, which max() may drop.
            worst = {key: float(np.maximum(worst[key], now[key])) for key in worst}
    worst["seconds"] = time.perf_counter() - begin
    return worst


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--robot", default="space_arm_7")
    arguments = parser.parse_args()
    sms = ffsms.load(arguments.robot)
    print(f"Free flight of {arguments.robot} over {arguments.hours:g} h, largest drifts:\n")
    print("| integrator | step [s] | linear momentum | angular momentum | energy | quaternion | time [s] |")
    print("|---|---|---|---|---|---|---|")
    for name, steps in STEPS.items():
        for dt in steps:
            worst = free_flight(name, sms, 3600.0 * arguments.hours, dt)
            print(
                f"| {name} | {dt:g} | {worst['linear']:.1e} | {worst['angular']:.1e} | "
                f"{worst['energy']:.1e} | {worst['quaternion']:.1e} | {worst['seconds']:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
