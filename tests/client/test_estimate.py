"""A client that is seen noisily and late."""

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.client import ClientEstimate, ClientSensor, measured

SENSOR = ClientSensor(0.002, 0.005, 0.002, 0.002, latency=0.2)
END = 12.0


def _client() -> ffsms.Client:
    pose = pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([1.0, 0.2, -0.3]))
    return ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, [0.01, -0.02, 0.01, 0.05, 0.04, -0.03])


def _errors(one: ffsms.Client | ClientEstimate, client: ffsms.Client, t: float) -> np.ndarray:
    """Of position, velocity, attitude and spin."""
    turn = pin.log3(one.pose(t).rotation @ client.pose(t).rotation.T)
    shift = one.pose(t).translation - client.pose(t).translation
    rates = one.twist(t) - client.twist(t)
    return np.array([np.linalg.norm(part) for part in (shift, rates[:3], turn, rates[3:])])


def _watched(seed: int, wrong: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the estimate, and of the last measurement held, 12 s on."""
    client, rng = _client(), np.random.default_rng(seed)
    first = measured(client, -SENSOR.latency, SENSOR, rng)
    estimate, seen = ClientEstimate(first, -SENSOR.latency, SENSOR), first
    for t in np.arange(0.1, END + 0.05, 0.1) - SENSOR.latency:
        seen = measured(client, float(t), SENSOR, rng)
        estimate.observe(seen, float(t))
    held = np.concatenate([seen.start_pose.translation - client.pose(END).translation, [0.0]])
    return _errors(estimate, client, END), np.array([np.linalg.norm(held)])


def test_it_is_far_better_than_what_is_measured() -> None:
    found = np.array([_watched(seed)[0] for seed in range(5)])
    noise = np.sqrt(3.0) * np.array([SENSOR.position_noise, SENSOR.velocity_noise, 0.005, 0.002])
    assert (np.sqrt((found**2).mean(axis=0)) < 0.3 * noise).all()
    # A measurement taken as it is would be late as well: 5 mm of motion in the latency.
    assert min(_watched(seed)[1][0] for seed in range(3)) > 0.002


def test_its_covariance_is_honest() -> None:
    """The errors' squares over their variances are one in the mean, 12 numbers of 20 runs."""
    shares = []
    for seed in range(20):
        client, rng = _client(), np.random.default_rng(100 + seed)
        estimate = ClientEstimate(measured(client, 0.0, SENSOR, rng), 0.0, SENSOR)
        for t in np.arange(0.5, 6.1, 0.5):
            estimate.observe(measured(client, float(t), SENSOR, rng), float(t))
        shift = client.pose(6.0).translation - estimate.pose(6.0).translation
        turn = pin.log3(client.pose(6.0).rotation @ estimate.pose(6.0).rotation.T)
        change = client.momentum[3:] - estimate.momentum[3:]
        x = np.concatenate([shift, (client.twist(6.0) - estimate.twist(6.0))[:3], turn, change])
        shares.append(x @ np.linalg.solve(estimate._P, x) / 12.0)
    assert 0.7 < np.mean(shares) < 1.35


def test_without_noise_it_is_exact() -> None:
    client, rng = _client(), np.random.default_rng(0)
    tiny = ClientSensor(1e-9, 1e-9, 1e-9, 1e-9)
    estimate = ClientEstimate(measured(client, -0.1, tiny, rng), -0.1, tiny)
    for t in (0.5, 1.0, 5.0):
        estimate.observe(measured(client, t, tiny, rng), t)
    assert _errors(estimate, client, 20.0).max() < 1e-6
