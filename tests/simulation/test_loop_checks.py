"""Checks of closed loops: unusable arguments are refused, and lost momentum is reported."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from typing import Any, get_type_hints

import numpy as np
import pytest
from base_actuators import PYRAMID, THRUSTER_DIRECTIONS, THRUSTER_POSITIONS
from motions import Constant, Swing, note_without_goal

import ffsms_pin as ffsms
from ffsms_pin import control
from ffsms_pin.control import PD
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue, SimulationDiverged, UnknownOption
from ffsms_pin.simulation import (
    Actuator,
    Capture,
    Conditions,
    Guards,
    JointFriction,
    Observer,
    Sensors,
    Supervisor,
    Wrench,
    simulate,
)
from ffsms_pin.simulation.setup import ConditionFields, set_up, warn_of_base
from ffsms_pin.system.dynamics import MODES

Refused = Callable[..., FfsmsError]


class Failing(PD):
    """A law that returns a value that is not finite after 20 steps."""

    value: Any = np.nan
    calls = 0

    def torque(self, *state: Any) -> Any:
        """Return the torque, after 20 steps the value."""
        self.calls += 1
        tau = super().torque(*state)
        return tau if self.calls <= 20 else self.value * np.ones_like(tau)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("drive", [None, Actuator(delay=0.003)])
def test_a_torque_that_is_not_finite_ends_the_run(
    planar: ffsms.SpaceManipulator, value: float, drive: Actuator | None
) -> None:
    law = Failing(planar)
    law.value = value
    with pytest.raises(SimulationDiverged, match=r"torque is not finite at t = 0\.02") as caught:
        simulate(planar, Swing(planar), law, conditions=Conditions(actuator=drive))
    late = 0 if drive is None else 3
    assert caught.value.time == pytest.approx(1e-3 * (20 + late))
    assert len(caught.value.tracking.t) == 21 + late
    assert all(np.isfinite(getattr(caught.value.tracking, name)).all() for name in ("q", "v", "tau", "work"))


def test_an_actuator_cuts_off_an_infinite_torque(planar: ffsms.SpaceManipulator) -> None:
    law = Failing(planar)
    law.value = np.inf
    run = simulate(
        planar, Swing(planar, duration=0.1), law, conditions=Conditions(actuator=Actuator(torque_limit=0.1))
    )
    assert run.tau.max() == 0.1


def test_a_torque_of_no_numbers_is_refused(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    for tau in (["a"] * 3, [1j] * 3, [None] * 3, [0.0] * 2, 0.0):
        law = Constant(np.zeros(3))
        law.tau = np.array(tau)
        refused(lambda law=law: simulate(planar, Swing(planar), law), InvalidValue, "controller.torque")


def test_wrong_kinds_of_object_are_named(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    good: dict[str, Any] = {"sms": planar, "reference": Swing(planar), "controller": PD(planar)}
    wrong: dict[str, Any] = {
        "sms": np.eye(3),
        "reference": np.zeros(3),
        "controller": "pd",
        "plant": "planar_3r",
        "progress": 1.0,
        "friction": 0.1,
        "actuator": {},
        "sensors": 0.0,
        "disturbances": 1.0,
        "events": 0.5,
        "guards": True,
        "integrator": ["rk4"],
    }
    for name, value in wrong.items():
        refused(
            lambda name=name, value=value: simulate(**{**good, name: value}),
            InvalidValue,
            name,
        )


def test_classes_in_place_of_instances_are_named(planar: ffsms.SpaceManipulator) -> None:
    good: dict[str, Any] = {"sms": planar, "reference": Swing(planar), "controller": PD(planar)}
    for name, value in (
        ("reference", Swing),
        ("controller", PD),
        ("base_controller", control.QuaternionFeedback),
        ("supervisor", Supervisor),
    ):
        with pytest.raises(InvalidValue, match=f"^{name} is a class; pass an instance"):
            simulate(**{**good, name: value})


def test_a_controller_needs_its_method(planar: ffsms.SpaceManipulator) -> None:
    class Without:
        """A law whose method has another name."""

        def torques(self, *_: Any) -> Any:
            """Return no torques."""
            return np.zeros(3)

    with pytest.raises(InvalidValue, match=r"^controller must be .* method torque\(q, v, q_d, qd_d, qdd_d\)"):
        simulate(planar, Swing(planar), Without())  # type: ignore[arg-type]


def test_objects_that_observe_derive_from_observer(planar: ffsms.SpaceManipulator) -> None:
    class Looking(Swing):
        """A reference with a method of an observer."""

        seen = 0

        def observe(self, t: float, q: Any, v: Any) -> None:
            """Count the control steps."""
            self.seen += 1

    class Observing(Looking, Observer):
        """The same reference as an observer."""

    class Structural(Looking):
        """A reference with all members of an observer."""

        replans, needs_wrist, failed_in_a_row = False, False, 0

        def observe_nothing(self, *_: Any) -> None:
            """Do nothing."""

        observe_sensors = observe_wheels = observe_wrench = observe_robot = observe_nothing
        joint_failed = expect_noise = observe_nothing

    with pytest.raises(InvalidValue, match=r"^reference has a method observe that .*simulation\.Observer"):
        simulate(planar, Looking(planar), PD(planar))
    for reference in (Observing(planar, duration=0.1), Structural(planar, duration=0.1)):
        simulate(planar, reference, PD(planar), conditions=Conditions(guards=None))
        assert reference.seen == 100


def test_an_object_that_is_both_observes_once(planar: ffsms.SpaceManipulator) -> None:
    class Both(PD):
        """A law that is its own reference."""

        def __init__(self) -> None:
            super().__init__(planar)
            self.swing, self.seen = Swing(planar, duration=0.1), 0
            self.q, self.duration, self.target = self.swing.q, 0.1, self.swing.target
            self.sample = self.swing.sample

        def observe(self, t: float, q: Any, v: Any) -> None:
            """Count the control steps."""
            self.seen += 1

    both = Both()
    simulate(planar, both, both, conditions=Conditions(guards=None))
    assert both.seen == 100


def test_a_reference_that_does_not_fit_is_refused(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    class Odd(Swing):
        values: Any = None

        def sample(self, t: float) -> Any:
            return self.values

    zeros, still = np.zeros(3), np.zeros(planar.nv)
    short, unknown = (zeros[:2], zeros, zeros), (zeros, zeros, np.full(3, np.nan))
    for values in (None, 1.0, (zeros, zeros), short, unknown, ("a", "b", "c")):
        odd = Odd(planar)
        odd.values = values
        for v0 in (None, still):
            refused(
                lambda odd=odd, v0=v0: simulate(planar, odd, PD(planar), conditions=Conditions(v0=v0)),
                InvalidValue,
                "reference",
            )


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"sensors": Sensors(joint_rate_noise=1e30)}, "sensors.joint_rate_noise"),
        ({"events": Capture(0.5, 1e30, np.eye(3))}, "capture.mass"),
        ({"events": Capture(0.5, 1.0, 1e30 * np.eye(3))}, "capture.inertia"),
        ({"events": Capture(0.5, 1.0, np.eye(3), twist=[1e30] * 6)}, "capture.twist"),
        ({"friction": JointFriction(viscous=3e71)}, "viscous"),
        ({"friction": JointFriction(coulomb=0.1, transition=1e-300)}, "transition"),
        ({"disturbances": Wrench([1e30, 0, 0, 0, 0, 0])}, "wrench"),
        ({"dt": 1e-9}, "2e+09 steps"),
        ({"dt": 1e-300}, "dt"),
        ({"v0": np.full(9, 1e30)}, "v0"),
    ],
)
def test_absurd_numbers_are_refused(
    refused: Refused, planar: ffsms.SpaceManipulator, options: dict[str, Any], fragment: str
) -> None:
    refused(lambda: simulate(planar, Swing(planar), PD(planar), **options), InvalidValue, fragment)


def test_a_run_too_long_for_its_memory_is_refused(refused: Refused, planar: ffsms.SpaceManipulator) -> None:
    long = Swing(planar, duration=1e9)
    refused(lambda: simulate(planar, long, PD(planar)), InvalidValue, "dt", "1e+12 steps")


def test_excessive_noise_ends_in_divergence_with_every_integrator(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Adaptive integrators reach the bound on their work after seconds; a tenth of the bound suffices.
    monkeypatch.setattr("ffsms_pin.simulation.integrators._MOST_SLOPES", 10_000)
    for integrator in ("rk4", "variational", "adaptive", "stiff"):
        with pytest.raises(SimulationDiverged):
            simulate(
                planar,
                Swing(planar, duration=0.02),
                PD(planar, K_d=100.0, torque_limit=np.inf),
                conditions=Conditions(sensors=Sensors(joint_rate_noise=1e9), integrator=integrator),
            )


@pytest.mark.long
@pytest.mark.slow
def test_lost_momentum_is_reported(planar: ffsms.SpaceManipulator) -> None:
    swing, law = Swing(planar), PD(planar, K_p=5.0, K_d=2.0)
    steep = JointFriction(coulomb=1.0, transition=1e-4)
    short = Swing(planar, displacement=(0.015, 0.02, -0.015), duration=0.08)
    assert note_without_goal(simulate(planar, short, law)) == ""
    run = simulate(planar, swing, law, dt=0.05)
    lost = float(np.linalg.norm(run.momentum[-1, :3] - run.momentum[0, :3]))
    assert "momentum changed without an external force" in run.note
    assert f"linear by {lost:.3g} kg m/s" in run.note
    # This friction would need thousands of substeps; linearly implicit steps are used and keep the momentum.
    runs = [
        simulate(planar, short, law, conditions=Conditions(friction=steep, integrator=name))
        for name in ("rk4", "stiff")
    ]
    assert [note_without_goal(run) for run in runs] == ["", ""]
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-6)
    assert np.abs(runs[0].momentum).max() < 1e-13
    # Steps of 1 ms are too long for this friction; each step has some fifty substeps.
    parts = simulate(planar, short, law, conditions=Conditions(friction=JointFriction(coulomb=1.0)))
    assert note_without_goal(parts) == ""
    stiff = simulate(
        planar, short, law, conditions=Conditions(friction=JointFriction(coulomb=1.0), integrator="stiff")
    )
    np.testing.assert_allclose(parts.q[-1], stiff.q[-1], atol=1e-6)


def test_momentum_changed_by_forces_and_captures_is_not_reported(planar: ffsms.SpaceManipulator) -> None:
    swing, law = Swing(planar), PD(planar, K_p=5.0, K_d=2.0)
    pushed = simulate(
        planar, swing, law, conditions=Conditions(disturbances=Wrench([0.1, 0.0, 0.0, 0.0, 0.0, 0.1]))
    )
    assert np.linalg.norm(pushed.momentum[-1] - pushed.momentum[0]) > 0.1
    assert note_without_goal(pushed) == ""
    flying = Capture(1.0, 2.0, 0.1 * np.eye(3), twist=[0.1, 0.0, 0.0, 0.0, 0.0, 0.5])
    captured = simulate(planar, swing, law, conditions=Conditions(events=flying))
    assert np.linalg.norm(captured.momentum[-1] - captured.momentum[0]) > 0.1
    assert note_without_goal(captured) == "t = 1 s: captured 2 kg"
    assert "external force" in simulate(planar, swing, law, 0.05, conditions=Conditions(events=flying)).note


def test_invalid_paths_of_guards_are_refused(refused: Refused) -> None:
    for path in (3, "", "a\0b", "x" * 300):
        refused(lambda path=path: Guards(path=path), InvalidValue, "guards.path")


def test_the_check_of_arguments_takes_all_conditions_that_simulate_takes() -> None:
    whole, checked = (inspect.signature(function).parameters for function in (simulate, set_up))
    assert set(whole) - set(checked) == {"controller", "progress", "supervisor", "fields"}
    for name, parameter in checked.items():
        assert parameter.default == whole[name].default


def test_repeated_and_misspelt_conditions_are_refused(
    refused: Refused, planar: ffsms.SpaceManipulator
) -> None:
    call: Any = simulate
    good = planar, Swing(planar), PD(planar)
    for name in ("actuator", "friction", "sensors"):
        refused(lambda name=name: call(*good, **{name: 3.0}), InvalidValue, name, "must be a")
    twice = Conditions(momentum=np.ones(6))
    refused(lambda: call(*good, conditions=twice, momentum=np.zeros(6)), InvalidValue, "momentum is also set")
    refused(lambda: call(*good, plnt=planar), UnknownOption, "plnt", "did you mean 'plant'?")
    refused(lambda: simulate(*good, conditions=PD), InvalidValue, "conditions must be a Conditions")  # type: ignore[arg-type]
    assert len(inspect.signature(simulate).parameters) <= 13  # the last one holds fields of Conditions


def test_conditions_may_be_given_by_their_names(planar: ffsms.SpaceManipulator) -> None:
    swing, law, friction = Swing(planar, duration=0.2), PD(planar), JointFriction(viscous=0.1)
    call: Any = simulate
    named = call(planar, swing, law, friction=friction, guards=None)
    grouped = simulate(planar, swing, law, conditions=Conditions(friction=friction, guards=None))
    np.testing.assert_array_equal(named.q, grouped.q)
    assert np.abs(named.q - simulate(planar, swing, law).q).max() > 1e-6


def test_fields_by_name_have_the_types_of_conditions() -> None:
    assert get_type_hints(ConditionFields) == get_type_hints(Conditions)


_MODES_OF_LAWS = {
    "none": ("floating",),
    "quaternion": ("rotation-floating", "rotation-flying"),
    "coordinated": ("rotation-floating", "rotation-flying"),
    "place": ("translation-flying",),
    "place and attitude": ("flying",),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", _MODES_OF_LAWS)
def test_every_mode_of_a_plan_with_every_base_law(
    planar: ffsms.SpaceManipulator, mode: str, name: str
) -> None:
    wheels, thrusters = (
        ffsms.ReactionWheels(PYRAMID, 0.001, 0.1, 1.0),
        ffsms.Thrusters(THRUSTER_POSITIONS, THRUSTER_DIRECTIONS, 5.0, proportional=True),
    )
    sms = planar.with_actuators(wheels=wheels, thrusters=thrusters)
    laws: dict[str, Any] = {
        "none": lambda: None,
        "quaternion": lambda: control.QuaternionFeedback(sms),
        "coordinated": lambda: control.Coordinated(sms),
        "place": lambda: control.StationKeeping(sms, holds="place"),
        "place and attitude": lambda: control.StationKeeping(sms),
    }
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_base(mode, laws[name](), sms, stacklevel=1)
    assert bool(caught) == (mode not in _MODES_OF_LAWS[name])
    if caught:
        assert f"plan with mode='{_MODES_OF_LAWS[name][0]}'" in str(caught[0].message)
        assert caught[0].category is FfsmsWarning


def test_a_custom_base_law_gives_no_warning(planar: ffsms.SpaceManipulator) -> None:
    class Idle:
        def command(self, view: control.BaseView) -> control.BaseCommand:
            return control.BaseCommand()

    warn_of_base("floating", Idle(), planar, stacklevel=1)
