"""Test numerical failures in the public functions, and unphysical values of robots and clients."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motions import HASTY, START, Swing

import ffsms_pin as ffsms
from ffsms_pin import capture, opt
from ffsms_pin.control import PD
from ffsms_pin.errors import FfsmsError, InvalidInertia, InvalidUrdf, InvalidValue, NumericalError
from ffsms_pin.robot import SatelliteBase
from ffsms_pin.simulation import Capture
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]
TARGET = (0.85, 0.45, 0.0)
START_Q = ffsms.load("planar_3r").configuration(START)
LINK_1 = '<inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0043" iyz="0" izz="0.0043"/>'
PLANAR = model_path("planar_3r").read_text()


def problem(sms: ffsms.SpaceManipulator) -> opt.Problem:
    return opt.Problem(sms, START_Q, TARGET, 6.0, 0.1)


def caught(sms: ffsms.SpaceManipulator) -> capture.Flight:
    """Simulate the capture of a client that is at the end effector already."""
    client = ffsms.Client(1.0, [0.1, 0.1, 0.1], sms.at(START_Q).end_effector_pose)
    return capture.fly(sms, START_Q, opt.Meet(client, standoff=0.0), 1.0, planning=capture.Planning(dt=0.1))


# The function that is replaced by a failing one, and a call that uses it.
CALLS: dict[str, tuple[str, Callable[[ffsms.SpaceManipulator], Any]]] = {
    "plan": ("numpy.linalg.svd", lambda sms: opt.plan(sms, START_Q, TARGET, 6.0, 0.1, method="step")),
    "solve": ("daqp.solve", lambda sms: opt.solve(problem(sms))),
    "shortest": ("daqp.solve", lambda sms: opt.shortest(problem(sms), options=HASTY)),
    "step": (
        "ffsms_pin.opt.step.stepper.StepState",
        lambda sms: opt.StepPlanner(sms).step(START_Q, np.zeros(3), TARGET, 5.0),
    ),
    "capture": ("pinocchio.aba", caught),
    "simulate": ("pinocchio.aba", lambda sms: ffsms.simulate(sms, Swing(sms), PD(sms), dt=0.01)),
}


def failing(error: Exception) -> Callable[..., Any]:
    """Return a function that raises `error`, and that seems to belong to NumPy."""
    module: dict[str, Any] = {"__name__": "numpy.linalg", "error": error}
    exec("def fail(*args, **options):\n    raise error", module)
    return module["fail"]  # type: ignore[no-any-return]


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("no convergence"), RuntimeError("assertion failed")])
@pytest.mark.parametrize("name", CALLS)
def test_a_numerical_failure_is_a_library_error_or_a_plan_with_a_note(
    monkeypatch: pytest.MonkeyPatch, planar: ffsms.SpaceManipulator, name: str, error: Exception
) -> None:
    replaced, call = CALLS[name]
    monkeypatch.setattr(replaced, failing(error))
    if name in ("solve", "shortest") and isinstance(error, np.linalg.LinAlgError):
        plan = call(planar)
        assert not plan.reached
        assert f"numerical failure ({error})" in plan.note
        return
    pattern = rf"failed numerically \({type(error).__name__}: {error}\); check"
    with pytest.raises(NumericalError, match=pattern) as failure:
        call(planar)
    assert failure.value.__cause__ is error


def test_errors_of_custom_controllers_are_passed_on(planar: ffsms.SpaceManipulator) -> None:
    class Own(PD):
        def torque(self, *_: Any) -> Any:
            return np.linalg.inv(np.zeros((3, 3)))

    with pytest.raises(np.linalg.LinAlgError):
        ffsms.simulate(planar, Swing(planar), Own(planar), dt=0.01)


def changed(folder: Path, old: str, new: str) -> Any:
    """Load the planar robot with `old` replaced by `new` in its file."""
    assert old in PLANAR
    (folder / "changed.urdf").write_text(PLANAR.replace(old, new, 1))
    return ffsms.load(folder / "changed.urdf", end_effector="end_effector")


def captured(**values: Any) -> Any:
    """Simulate the capture of a body with these values."""
    sms = ffsms.load("planar_3r")
    event = Capture(0.5, **{"mass": 2.0, "inertia": [0.1] * 3, **values})
    return ffsms.simulate(sms, Swing(sms), PD(sms), dt=0.1, conditions=ffsms.Conditions(events=event))


# The call, the class of its error, and words of the message: the value, the bound and the unit.
UNPHYSICAL: dict[str, tuple[Callable[[Path], Any], type[FfsmsError], tuple[str, ...]]] = {
    "a captured body far off the gripper": (
        lambda _: captured(com=[1e6, 0.0, 0.0]),
        InvalidValue,
        ("capture.com", "1e+06 m", "gyration is 0.274 m", "within 2.74e+04 m", "check the units"),
    ),
    "a captured body of 500 km": (
        lambda _: captured(inertia=[2e11] * 3),
        InvalidValue,
        ("capture.inertia", "gyration", "e+05 m", "units"),
    ),
    "a client of 1000 km": (
        lambda _: ffsms.Client(1e-3, [1e9] * 3),
        InvalidValue,
        ("inertia", "1.22e+06 m", "1e-06 and 100000 m", "check units and mass"),
    ),
    "a client smaller than an atom": (lambda _: ffsms.Client(1e9, [1e-9] * 3), InvalidValue, ("gyration",)),
    "a satellite whose centre is elsewhere": (
        lambda _: SatelliteBase(com=(0.0, 11.0, 0.0)),
        InvalidValue,
        ("com", "11 m", "1 m", "check the units"),
    ),
    "a satellite of 200 km": (
        lambda _: SatelliteBase(size=(2e5, 1.0, 1.0)),
        InvalidValue,
        ("size", "100000"),
    ),
    "a link whose centre is 10 000 km away": (
        lambda folder: changed(folder, 'xyz="0.15 0 0"', 'xyz="1e7 0 0"'),
        InvalidInertia,
        ("link_1", "1e+07 m", "check the units"),
    ),
    "a link of 569 g with the inertia of an asteroid": (
        lambda folder: changed(folder, LINK_1, LINK_1.replace("0.0043", "0.0043e14")),
        InvalidInertia,
        ("link_1", "0.569 kg", "gyration"),
    ),
    "joints 1000 km apart": (
        lambda folder: changed(folder, '"0.232 0 0"', '"1e6 0 0"'),
        InvalidUrdf,
        ("joint_1", "1e+06 m", "100000 m", "metres"),
    ),
}


@pytest.mark.parametrize("case", UNPHYSICAL)
def test_unphysical_bodies_are_refused(tmp_path: Path, refused: Refused, case: str) -> None:
    make, kind, fragments = UNPHYSICAL[case]
    refused(lambda: make(tmp_path), kind, *fragments)


def test_stations_and_asteroids_can_be_clients() -> None:
    station = ffsms.Client(4.2e5, [1.3e8, 1.0e8, 1.9e8])
    asteroid = ffsms.Client(7.3e10, [1.8e15] * 3)  # kg, of 250 m radius
    assert station.momentum.shape == asteroid.momentum.shape == (6,)
