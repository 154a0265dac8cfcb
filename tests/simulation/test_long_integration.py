"""The integrators by name: their order, conserved quantities, and agreement with each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import Flying, random_pose
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation import INTEGRATORS, Conditions, simulate
from ffsms_pin.simulation.integrators import rk4_step, variational_step

Array = NDArray[np.float64]
KINDS = ("revolute", "prismatic", "continuous")


class Flight(Flying):
    """A random robot tumbling freely, its centre of mass at rest."""

    def __init__(self, tree: Any, seed: int, speed: float) -> None:
        rng = np.random.default_rng(seed)
        self.sms = ffsms.SpaceManipulator(tree.model(), "tip")
        self.model, self.data = self.sms.model, self.sms.model.createData()
        self.q = self.sms.configuration(rng.uniform(-1.0, 1.0, self.sms.n), random_pose(rng))
        spin = self.sms.at(self.q).H_b[3:, 3:] @ rng.normal(size=3) * speed
        rates = speed * rng.normal(size=self.sms.n)
        self.v = self.sms.velocity(self.q, rates, np.concatenate([np.zeros(3), spin]))

    def run(self, name: str, duration: float, steps: int, force: Any = None) -> tuple[Array, Array, float]:
        """Return the state and the work after a number of steps."""
        q, v, work, h = self.q, self.v, 0.0, duration / steps
        force = np.zeros(self.sms.nv) if force is None else force
        for k in range(steps):
            q, v, done = INTEGRATORS[name](self.model, self.data, q, v, force, h, k * h)
            work += done
        return q, v, work


@pytest.mark.parametrize(("seed", "n"), [(21, 1), (22, 3), (23, 6)])
def test_variational_step_has_order_four(seed: int, n: int, random_tree: Callable[..., Any]) -> None:
    flight = Flight(random_tree(seed, n, KINDS), seed, 0.8)
    force = np.concatenate([np.zeros(6), np.random.default_rng(seed).normal(size=n)])
    q_ref, v_ref, work_ref = flight.run("rk4", 0.4, 1500, force)
    errors = []
    for steps in (10, 20):
        q, v, work = flight.run("variational", 0.4, steps, force)
        difference = pin.difference(flight.model, q_ref, q)
        errors.append([np.linalg.norm(difference), np.linalg.norm(v - v_ref), abs(work - work_ref)])
    coarse, fine = np.array(errors)
    assert (fine > 1e-12).all()
    assert (coarse / fine > 10.0).all()


@pytest.mark.parametrize("name", sorted(INTEGRATORS))
def test_integrators_agree_under_forces_that_vary(name: str, random_tree: Callable[..., Any]) -> None:
    flight = Flight(random_tree(24, 3), 24, 0.5)
    direction = np.random.default_rng(24).normal(size=flight.sms.nv)

    def force(t: float, q: Array, v: Array) -> Array:
        return np.asarray(direction * np.cos(3.0 * t) - 0.5 * v + 0.1 * np.sin(q[:3]).sum())

    q_ref, v_ref, work_ref = flight.run("rk4", 0.5, 1000, force)
    # The other integrators are independent of rk4, which itself is compared with finer steps.
    q, v, work = flight.run(name, 0.5, 100, force)
    limit = {"stiff": 1e-5}.get(name, 1e-6)
    assert np.linalg.norm(pin.difference(flight.model, q_ref, q)) < limit
    np.testing.assert_allclose(v, v_ref, atol=limit)
    assert work == pytest.approx(work_ref, abs=limit)
    assert abs(work) > 0.05
    gain = flight.energy(q, v) - flight.energy(flight.q, flight.v)
    assert gain == pytest.approx(work, abs=10.0 * limit)


@pytest.mark.parametrize(
    ("name", "dt", "momentum", "energy"),
    [("rk4", 0.01, 1e-11, 1e-11), ("variational", 0.2, 1e-12, 1e-6), ("adaptive", 1.0, 1e-11, 1e-11)],
)
def test_free_flight_keeps_momentum_and_energy(
    name: str, dt: float, momentum: float, energy: float, planar_tree: Any
) -> None:
    # A short part of benchmarks/integrators.py, which flies for an hour.
    flight = Flight(planar_tree, 25, 0.02)
    q, v, work = flight.run(name, 60.0, round(60.0 / dt))
    before = flight.momentum(flight.q, flight.v)
    after = flight.momentum(q, v)
    assert np.linalg.norm(before[3:]) > 0.01
    assert np.linalg.norm(after - before) < momentum * np.linalg.norm(before)
    assert flight.energy(q, v) == pytest.approx(flight.energy(flight.q, flight.v), rel=energy)
    assert abs(np.linalg.norm(q[3:7]) - 1.0) < 1e-12
    assert work == pytest.approx(0.0, abs=1e-15)


def test_variational_energy_oscillates_where_runge_kutta_drifts(planar_tree: Any) -> None:
    flight = Flight(planar_tree, 26, 0.2)
    energy = flight.energy(flight.q, flight.v)
    drifts = {}
    for name, step in (("rk4", rk4_step), ("variational", variational_step)):
        q, v, errors = flight.q, flight.v, []
        for _ in range(1000):
            q, v, _ = step(flight.model, flight.data, q, v, np.zeros(flight.sms.nv), 0.1)
            errors.append(flight.energy(q, v) / energy - 1.0)
        drifts[name] = abs(np.mean(errors[-300:])), np.abs(errors).max()
    assert drifts["variational"][0] < 0.2 * drifts["rk4"][0]


@pytest.mark.parametrize("name", sorted(INTEGRATORS))
def test_closed_loop_runs_with_each(name: str, planar: ffsms.SpaceManipulator) -> None:
    start = np.deg2rad([1.0, 1.0, 1.0])

    class Step:
        duration, target, q = 0.2, np.zeros(3), planar.configuration(start)[np.newaxis]

        def sample(self, t: float) -> tuple[Array, Array, Array]:
            return start + 0.5 * t * t, np.full(3, t), np.ones(3)

    law = ComputedTorque(planar)
    tracking = simulate(
        planar, Step(), law, dt=5e-3, conditions=Conditions(integrator=name, momentum=[0, 0, 0, 0, 0, 0.5])
    )
    np.testing.assert_allclose(tracking.momentum, np.tile([0, 0, 0, 0, 0, 0.5], (41, 1)), atol=1e-9)
    reference = simulate(planar, Step(), law, dt=5e-3, conditions=Conditions(momentum=[0, 0, 0, 0, 0, 0.5]))
    np.testing.assert_allclose(tracking.q, reference.q, atol=1e-7)
    assert np.abs(tracking.energy_error).max() < 1e-6 * np.abs(tracking.work).max()
