"""How well a client is known at the contact, where some of its measurements are grossly wrong.

Run from the repository's root: python benchmarks/client_filter.py [--runs 100]
A client of 80 kg tumbles at 4 deg/s and is measured ten times a second for 12 s (2 mm, 5 mrad, 2 mm/s and
2 mrad/s of noise); an outlier's noise is a hundred times as large. Printed are the estimate's errors at 12 s.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import ClientEstimate, ClientSensor, measured

END = 12.0  # [s]
TWIST = [0.01, -0.02, 0.01, 0.05, 0.04, -0.03]


def errors(share: float, seed: int) -> FloatArray:
    """Of place [mm] and attitude [mrad], and how many measurements were refused."""
    pose = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([1.0, 0.2, -0.3]))
    client, rng = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, TWIST), np.random.default_rng(seed)
    sensor = ClientSensor(outliers=share)
    estimate = ClientEstimate(measured(client, 0.0, sensor, rng), 0.0, sensor)
    for t in np.arange(1, round(END / sensor.period) + 1) * sensor.period:
        estimate.observe(measured(client, float(t), sensor, rng), float(t))
    true, known = client.pose(END), estimate.pose(END)
    turn = pin.log3(known.rotation @ true.rotation.T)
    off = np.linalg.norm(known.translation - true.translation)
    return 1e3 * np.array([off, np.linalg.norm(turn), 1e-3 * estimate.refused])


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    runs = parser.parse_args().runs
    print("| outliers | off by, median, 95 %, worst [mm] | turned by, median, worst [mrad] | refused |")
    print("|---|---|---|---|")
    for share in (0.0, 0.01, 0.05, 0.2):
        off, turned, refused = np.array([errors(share, seed) for seed in range(runs)]).T
        places = ", ".join(f"{one:.2g}" for one in np.percentile(off, [50, 95, 100]))
        turns = f"{np.median(turned):.2g}, {turned.max():.2g}"
        print(f"| {100 * share:g} % | {places} | {turns} | {refused.mean():.1f} of 120 |")


if __name__ == "__main__":
    main()
