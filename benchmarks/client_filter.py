"""Measure the errors of the estimated motion of a client, and their ratio to the estimated deviations.

Run from the repository's root: python benchmarks/client_filter.py [--runs 100]
A client of 80 kg tumbles at 4 deg/s and is measured ten times a second for 12 s (2 mm, 5 mrad, 2 mm/s and
2 mrad/s of noise); the noise of an outlier is a hundred times as large. The first table has the errors of the
estimate at 12 s.

In the second table clients tumble at 2 to 12 deg/s about any axis. Their inertias are drawn about the assumed
inertias, with a relative standard deviation of 0.1. The table has the ratio of squared errors to estimated
variances (position, velocity, attitude, angular velocity; at 12 s and predicted for 17 s). It is 1 for a
consistent estimate.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin
from scipy.linalg import expm

import ffsms_pin as ffsms
from ffsms_pin.capture.camera import Camera, measured
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.checks import FloatArray

END = 12.0  # [s]
TWIST = [0.01, -0.02, 0.01, 0.05, 0.04, -0.03]


def errors(share: float, seed: int) -> FloatArray:
    """Return the errors of position [mm] and attitude [mrad], and the number of rejected measurements."""
    pose = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([1.0, 0.2, -0.3]))
    client, rng = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, TWIST), np.random.default_rng(seed)
    sensor = Camera(outliers=share)
    estimate = ClientEstimate(measured(client, 0.0, sensor, rng), 0.0, sensor)
    for t in np.arange(1, round(END / sensor.period) + 1) * sensor.period:
        estimate.observe(measured(client, float(t), sensor, rng), float(t))
    true, known = client.pose(END), estimate.pose(END)
    turn = pin.log3(known.rotation @ true.rotation.T)
    off = np.linalg.norm(known.translation - true.translation)
    return 1e3 * np.array([off, np.linalg.norm(turn), 1e-3 * estimate.refused])


def squares(rate: float, seed: int, doubt: float = 0.1) -> FloatArray:
    """Return ratios (2,) of squared errors to variances at 12 and 17 s, for a client at `rate` [deg/s]."""
    rng = np.random.default_rng(seed)
    axis, pose = rng.normal(size=3), pin.SE3(pin.exp3(rng.normal(size=3)), np.array([1.0, 0.2, -0.3]))
    spin = np.radians(rate) / np.linalg.norm(axis) * axis
    believed = ffsms.Client(80.0, np.diag([6.0, 9.0, 11.0]), pose, [*TWIST[:3], *spin])
    moments = np.sqrt(0.5 * np.trace(believed.inertia) - np.diag(believed.inertia))
    x = doubt * rng.normal(size=(3, 3))
    moments = moments[:, None] * expm((x + x.T) / np.sqrt(2.0)) * moments
    true = ffsms.Client(80.0, np.trace(moments) * np.eye(3) - moments, pose, believed.start_twist)
    sensor = Camera()
    estimate = ClientEstimate(measured(true, 0.0, sensor, rng, believed), 0.0, sensor, 0.0, doubt)
    for t in np.arange(1, round(END / sensor.period) + 1) * sensor.period:
        estimate.observe(measured(true, float(t), sensor, rng, believed), float(t))

    def apart(one: ffsms.Client, t: float) -> FloatArray:
        turn = pin.log3(one.pose(t).rotation @ estimate.pose(t).rotation.T)
        way = one.pose(t).translation - estimate.pose(t).translation
        return np.concatenate([way, turn, one.twist(t) - estimate.twist(t)])

    found = []
    for t in (END, END + 5.0):
        spread = np.array([apart(one, t) for one in estimate.spread()])
        found.append(apart(true, t) @ np.linalg.solve(spread.T @ spread, apart(true, t)) / 12.0)
    return np.array(found)


def main() -> None:
    """Print two Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    runs = parser.parse_args().runs
    print(
        "| outliers | position error, median, 95 %, max [mm] "
        "| attitude error, median, max [mrad] | rejected |"
    )
    print("|---|---|---|---|")
    for share in (0.0, 0.01, 0.05, 0.2):
        off, turned, refused = np.array([errors(share, seed) for seed in range(runs)]).T
        places = ", ".join(f"{one:.2g}" for one in np.percentile(off, [50, 95, 100]))
        turns = f"{np.median(turned):.2g}, {turned.max():.2g}"
        print(f"| {100 * share:g} % | {places} | {turns} | {refused.mean():.1f} of 120 |")
    print("\n| rate of the client [deg/s] | ratio at 12 s, mean, max | predicted for 17 s, mean, max |")
    print("|---|---|---|")
    for rate in (2.0, 4.0, 8.0, 12.0):
        found = np.array([squares(rate, seed) for seed in range(runs)]).T
        print(f"| {rate:g} | " + " | ".join(f"{one.mean():.2f}, {one.max():.1f}" for one in found) + " |")


if __name__ == "__main__":
    main()
