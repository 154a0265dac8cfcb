"""Test that damaged recordings cause an error instead of a wrong estimate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from recorded import recording_of, with_changed_base

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification import Identifier, identify
from ffsms_pin.simulation import Conditions, Sensors, Wrench, simulate


@pytest.fixture
def arrays(panda: ffsms.SpaceManipulator) -> Any:
    """Return arrays t, q, v of a good recording."""
    tracking = recording_of(with_changed_base(panda), panda)
    return np.array(tracking.t), np.array(tracking.q), np.array(tracking.v)


@pytest.fixture
def noisy(panda: ffsms.SpaceManipulator, arrays: Any) -> Any:
    """Return the recording with noise of ordinary sensors."""
    sensors = Sensors(
        joint_resolution=1e-4, joint_rate_noise=1e-3, base_position_noise=1e-3, base_attitude_noise=1e-4,
        base_velocity_noise=1e-3, base_rate_noise=1e-4,
    )  # fmt: skip
    measure = sensors.start(panda, 5e-3, 7.0)
    rows = [measure(q, v) for q, v in zip(*arrays[1:], strict=True)]
    return arrays[0], np.array([q for q, _ in rows]), np.array([v for _, v in rows])


def test_noise_alone_is_no_fault(panda: ffsms.SpaceManipulator, noisy: Any) -> None:
    assert identify(panda, recording=noisy)["base"].mass == pytest.approx(180.567, rel=0.02)


@pytest.mark.parametrize("kind", ["arrays", "noisy"])
def test_damaged_recordings_are_refused(
    kind: str, panda: ffsms.SpaceManipulator, refused: Callable[..., Any], request: pytest.FixtureRequest
) -> None:
    t, q, v = request.getfixturevalue(kind)
    name = panda.joint_names[2]

    def damaged(*fragments: str, **columns: Any) -> None:
        rows = {"t": t.copy(), "q": q.copy(), "v": v.copy()} | columns
        recording = rows["t"], rows["q"], rows["v"]
        refused(lambda: identify(panda, recording=recording), InvalidValue, *fragments)

    def other(array: Any, where: Any, value: Any) -> Any:
        made = array.copy()
        made[where] = value
        return made

    middle = slice(300, 800)
    gap = np.r_[0:400, 500 : len(t)]
    refused(
        lambda: identify(panda, recording=(t[gap], q[gap], v[gap])), InvalidValue, "gap from 1.995 to 2.5 s"
    )
    damaged("must increase", t=other(t, 500, t[499]))
    damaged("frozen", f"position of joint '{name}'", q=other(q, (middle, 9), q[300, 9]))
    damaged("frozen", f"velocity of joint '{name}'", v=other(v, (middle, 8), v[300, 8]))
    damaged("frozen", "velocity of the base", v=other(v, (middle, slice(3, 6)), v[300, 3:6]))
    damaged(
        "degrees",
        f"positions of joint '{panda.joint_names[0]}'",
        q=other(q, np.s_[:, 7:], np.degrees(q[:, 7:])),
    )
    damaged("degrees", v=other(v, np.s_[:, 6:], np.degrees(v[:, 6:])))
    damaged("degrees", "velocities of the base about", v=other(v, np.s_[:, 3:6], np.degrees(v[:, 3:6])))
    both = {
        "q": other(q, np.s_[:, 7:], np.degrees(q[:, 7:])),
        "v": other(v, np.s_[:, 6:], np.degrees(v[:, 6:])),
    }
    damaged("degrees", **both)
    damaged("quaternion", q=other(q, np.s_[:, 3:7], 2.0 * q[:, 3:7]))
    damaged("quaternions (w, x, y, z)", q=other(q, np.s_[:, 3:7], q[:, [6, 3, 4, 5]]))
    damaged("that differ by", v=other(v, np.s_[:, 6:], v[:, 6:][:, ::-1]))
    damaged("finite", v=other(v, (3, 4), np.nan))
    damaged("shape", v=v[:-1])


@pytest.mark.parametrize("turned", [0.0, 1.2])
@pytest.mark.parametrize("base_velocity", ["mixed", "inertial"])
def test_other_velocity_axes_are_converted_or_refused(
    turned: float, base_velocity: str, panda: ffsms.SpaceManipulator, arrays: Any, refused: Callable[..., Any]
) -> None:
    """Test the axes of MuJoCo and of an inertial frame, for a base that rotates by 0.1 rad only."""
    (t, q, v), turn = arrays, pin.SE3(pin.exp3(np.array([0.0, 0.0, turned])), np.zeros(3))
    q, w = q.copy(), v.copy()
    for k, row in enumerate(q):
        pose = turn * pin.XYZQUATToSE3(row[:7])
        q[k, :7] = pin.SE3ToXYZQUAT(pose)
        w[k, :3] = pose.rotation @ v[k, :3]
        if base_velocity == "inertial":
            w[k, 3:6] = pose.rotation @ v[k, 3:6]
    q[::2, 3:7] *= -1.0  # the same attitudes
    assert identify(panda, recording=(t, q, v))["base"].mass == pytest.approx(180.567, rel=1e-4)
    identified = identify(panda, recording=(t, q, w), base_velocity=base_velocity)
    assert identified["base"].mass == pytest.approx(180.567, rel=1e-4)
    remedy = f'base_velocity="{base_velocity}"'
    refused(lambda: identify(panda, recording=(t, q, w)), InvalidValue, remedy)
    raw = np.column_stack([q[:, :3], q[:, [6, 3, 4, 5]], q[:, 7:]])
    refused(lambda: identify(panda, recording=(t, raw, w)), InvalidValue, remedy, "[4, 5, 6, 3]")
    wrong: Any = {"recording": (t, q, v), "base_velocity": base_velocity}
    refused(lambda: identify(panda, **wrong), InvalidValue, 'base_velocity="local"')


def test_times_of_any_spacing(panda: ffsms.SpaceManipulator, arrays: Any, rng: np.random.Generator) -> None:
    rows = np.sort(rng.choice(len(arrays[0]), 400, replace=False))
    identified = identify(panda, recording=tuple(x[rows] for x in arrays))
    assert identified["base"].mass == pytest.approx(180.567, rel=1e-5)


def test_velocities_in_millimetres_and_zero_velocities_are_refused(
    panda: ffsms.SpaceManipulator, arrays: Any, refused: Callable[..., Any]
) -> None:
    t, q, v = arrays
    size, none = np.ones(panda.nv), np.ones(panda.nv)
    size[:3], none[:3] = 1e3, 0.0
    large = np.column_stack([1e3 * q[:, :3], q[:, 3:]])
    refused(lambda: identify(panda, recording=(t, large, v * size)), InvalidValue, "millimetres")
    refused(lambda: identify(panda, recording=(t, q, v * none)), InvalidValue, "v[:, :3] = np.nan")


def test_recordings_with_external_forces_are_refused(
    planar: ffsms.SpaceManipulator, swing: Any, law: Any, refused: Any
) -> None:
    push = Wrench([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], on="base", start=1.0, end=1.2)
    tracking = simulate(planar, swing, law, conditions=Conditions(disturbances=push))
    refused(lambda: identify(planar, tracking), InvalidValue, "external forces", "between(start, end)")
    assert identify(planar, tracking.between(0.0, 0.99))["base"].mass == pytest.approx(31.015, rel=1e-4)


def test_a_model_that_differs_elsewhere_is_noted(panda: ffsms.SpaceManipulator, arrays: Any) -> None:
    t, q, v = arrays
    sensors = Sensors(base_velocity_noise=1e-5, base_rate_noise=1e-5, joint_rate_noise=1e-5)
    identified = identify(panda, recording=(t, q, v), unknown=[panda.joint_names[3]], sensors=sensors)
    assert "other bodies differ from the model" in identified.note


def test_arguments(panda: ffsms.SpaceManipulator, arrays: Any, refused: Any) -> None:
    def wrong(*fragments: str, **options: Any) -> None:
        refused(lambda: identify(panda, **{"recording": arrays, **options}), InvalidValue, *fragments)

    wrong("list of names", unknown="base")
    wrong("did you mean", unknown=["panda_link99"])
    wrong("each body once", unknown=["base", "base"])
    wrong("payload cannot be distinguished", unknown=["payload", panda.joint_names[-1]])
    wrong("not among the unknown", known={panda.joint_names[0]: 2.0})
    wrong("known.base", "mass and inertia", known={"base": {"mass": 3.0}})
    wrong("known.base", "mass and inertia", known={"base": {"mass": 3.0, "inertia": np.eye(3), "comm": 0.0}})
    wrong("spread", spread=0.0)
    wrong("not both", tracking=recording_of(with_changed_base(panda), panda))
    wrong(
        "local", tracking=recording_of(with_changed_base(panda), panda), recording=None, base_velocity="mixed"
    )
    wrong("local", base_velocity="world")
    unseen = arrays[0], arrays[1], np.column_stack([np.full((len(arrays[0]), 3), np.nan), arrays[2][:, 3:]])
    wrong("not measured", recording=(*unseen, np.zeros((len(arrays[0]), 7))))
    wrong("no torques", use_torques=True)
    wrong("no wheels", wheel_momentum=np.zeros((len(arrays[0]), 3)))
    wrong("tuple", recording=arrays[0])
    identifier = Identifier(panda, ["base"])
    identifier.update(0.0, arrays[1][0], arrays[2][0])
    refused(lambda: identifier.update(0.0, arrays[1][1], arrays[2][1]), InvalidValue, "later")
    refused(lambda: identifier.update(0.1, arrays[1][1, :-1], arrays[2][1]), InvalidValue, "shape")


def test_a_slow_motion_in_degrees_is_refused(
    panda: ffsms.SpaceManipulator, arrays: Any, refused: Callable[..., Any]
) -> None:
    """The rates agree with the positions and are below their limits, so only the positions reveal degrees."""
    t, q, v = arrays
    q, v = q.copy(), v / 100.0
    q[:, 7:], v[:, 6:] = np.degrees(q[:, 7:]), np.degrees(v[:, 6:])
    recording = 100.0 * t, q, v
    refused(lambda: identify(panda, recording=recording), InvalidValue, "positions of joint", "degrees")


def test_joints_in_another_order_are_noted(panda: ffsms.SpaceManipulator, arrays: Any) -> None:
    t, q, v = arrays
    assert "no values of the parameters explain" not in identify(panda, recording=(t, q, v)).note
    swapped = t, q[:, [*range(7), *range(13, 6, -1)]], v[:, [*range(6), *range(12, 5, -1)]]
    assert "no values of the parameters explain" in identify(panda, recording=swapped).note
