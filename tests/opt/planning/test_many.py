"""Many plans and simulations over processes: the same bits, in order, one failure apart from the others."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import fields
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import Impedance, SlidingModeController
from ffsms_pin.engine import Outcome, outcomes
from ffsms_pin.errors import FfsmsError, InvalidValue, SimulationStopped, TaskError, TasksFailed
from ffsms_pin.simulation import Sensors, Watchdog, perturb, simulate, simulate_each, simulate_many

Array = NDArray[np.float64]
Refused = Callable[..., FfsmsError]
TARGETS = [(1.0, 0.15, 0.0), (0.45, 0.75, 0.0), (0.9, -0.3, 0.0), (0.8, 0.5, 0.0)]
DURATIONS = [8.0, 12.0, 8.0, 6.0]


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit in every field."""
    return all(alike(getattr(a, field.name), getattr(b, field.name)) for field in fields(a))


def alike(one: Any, other: Any) -> bool:
    """Arrays by their bits, dictionaries entry by entry, in their order."""
    if isinstance(one, np.ndarray):
        same_kind = one.dtype == other.dtype and one.shape == other.shape
        return bool(same_kind and one.tobytes() == other.tobytes())
    if isinstance(one, dict):
        return list(one) == list(other) and all(alike(one[key], other[key]) for key in one)
    return bool(one == other)


@pytest.fixture(scope="module")
def start(planar: ffsms.SpaceManipulator) -> Array:
    return planar.configuration(np.radians([1.0, 1.0, 1.0]))


@pytest.fixture(scope="module")
def alone(planar: ffsms.SpaceManipulator, start: Array) -> list[opt.Trajectory]:
    """The plans to all targets, one by one."""
    return [opt.plan(planar, start, *task) for task in zip(TARGETS, DURATIONS, strict=True)]


@pytest.fixture(scope="module")
def stepped(planar: ffsms.SpaceManipulator, start: Array) -> list[opt.Trajectory]:
    """The same by steps."""
    return [opt.plan(planar, start, target, 6.0, method="step") for target in TARGETS]


@pytest.mark.parametrize("jobs", [1, 2])
def test_plans_are_those_of_plan_to_the_last_bit(
    planar: ffsms.SpaceManipulator, start: Array, alone: list[opt.Trajectory], jobs: int
) -> None:
    shares: list[float] = []
    many = opt.plan_many(planar, start, TARGETS, DURATIONS, jobs=jobs, progress=shares.append)
    for expected, found in zip(alone, many, strict=True):
        assert same(found, expected)
        assert not found.q.flags.writeable
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_seven_joints_and_poses(panda_like: ffsms.SpaceManipulator) -> None:
    sms = panda_like
    joints = [np.full(7, 0.3), np.full(7, 0.4)]
    starts = [sms.configuration(row) for row in joints]
    pose = sms.at(sms.configuration(np.full(7, 0.5))).end_effector_pose
    many = opt.plan_many(sms, starts, pose, 6.0, dt=0.05, jobs=2, method="step", collision="off")
    for q0, found in zip(starts, many, strict=True):
        assert same(found, opt.plan(sms, q0, pose, 6.0, 0.05, method="step", collision="off"))
    mixed = opt.plan_many(sms, starts, [pose, pose.translation], 6.0, 0.05, jobs=2, method="step")
    assert np.isfinite(mixed[0].target_rotation).all()
    assert np.isnan(mixed[1].target_rotation).all()


@pytest.fixture(scope="module")
def panda_like() -> ffsms.SpaceManipulator:
    return ffsms.load("space_arm_7")


def test_one_of_everything_is_one_plan(
    planar: ffsms.SpaceManipulator, start: Array, stepped: list[opt.Trajectory]
) -> None:
    (found,) = opt.plan_many(planar, start, TARGETS[0], 6.0, method="step")
    assert same(found, stepped[0])
    assert opt.plan_many(planar, start, [], 6.0) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failure_is_told_by_its_index_and_the_others_are_kept(
    planar: ffsms.SpaceManipulator, start: Array, stepped: list[opt.Trajectory], jobs: int
) -> None:
    starts = [start, planar.configuration([0.0, 9.0, 0.0]), start]
    with pytest.raises(
        TasksFailed, match=r"1 of 3 tasks failed, the first at index 1 \(InvalidValue: q0"
    ) as e:
        opt.plan_many(planar, starts, TARGETS[:3], 6.0, jobs=jobs, method="step")
    assert list(e.value.failures) == [1]
    assert isinstance(e.value.failures[1], InvalidValue)
    assert e.value.results[1] is None
    for i in (0, 2):
        assert same(e.value.results[i], stepped[i])


def test_wrong_arguments_are_refused_before_any_process_starts(
    planar: ffsms.SpaceManipulator, start: Array, refused: Refused
) -> None:
    def many(*arguments: Any, **options: Any) -> Any:
        return opt.plan_many(planar, *arguments, **options)

    refused(lambda: many(start, TARGETS, [6.0, 7.0]), InvalidValue, "4 of target", "2 of duration")
    refused(lambda: many(start, np.zeros((2, 2, 3))), InvalidValue, "target")
    refused(lambda: many(start, TARGETS, jobs=0), InvalidValue, "jobs")
    refused(lambda: many(start, TARGETS, jobs=True), InvalidValue, "jobs")
    refused(lambda: many(start, TARGETS, colision="off"), InvalidValue, "colision")
    refused(lambda: simulate_many(planar, None, None, integrate="rk4"), InvalidValue, "integrate")
    refused(lambda: simulate_many(planar, [1, 2], [1, 2, 3]), InvalidValue, "2 of reference")


def test_each_takes_tasks_only_as_they_are_needed(planar: ffsms.SpaceManipulator, start: Array) -> None:
    taken = 0

    def tasks() -> Iterator[tuple[Array, Any, float]]:
        nonlocal taken
        for i in count():
            taken += 1
            yield start, TARGETS[i % 4], 2.0

    expected = [opt.plan(planar, start, target, 2.0, 0.1, method="step") for target in TARGETS]
    for jobs in (1, 2):
        taken = 0
        found = list(islice(opt.plan_each(planar, tasks(), 0.1, jobs=jobs, method="step"), 5))
        assert [outcome.index for outcome in found] == [0, 1, 2, 3, 4]
        assert taken <= 5 + 4 * 2
        for i, outcome in enumerate(found):
            assert outcome.result is not None
            assert same(outcome.result, expected[i % 4])


def test_simulations_are_those_of_simulate_to_the_last_bit(
    planar: ffsms.SpaceManipulator, stepped: list[opt.Trajectory]
) -> None:
    plan = stepped[3]
    controller = Impedance(planar)  # it has a memory
    plants = [perturb(planar, arm_mass=factor) for factor in (0.9, 1.0, 1.1)]
    sensors = [Sensors(joint_noise=1e-6, seed=seed) for seed in range(3)]
    many = simulate_many(planar, plan, controller, 5e-3, plant=plants, sensors=sensors, jobs=2)
    alone = ffsms.simulate_many(planar, plan, controller, 5e-3, plant=plants, sensors=sensors, jobs=1)
    for plant, sensor, found, other in zip(plants, sensors, many, alone, strict=True):
        expected = simulate(planar, plan, controller, 5e-3, plant=plant, sensors=sensor)
        assert same(found, expected)
        assert same(other, expected)
        assert not found.tau.flags.writeable


def test_starts_in_rows_and_references_that_plan_again(planar: ffsms.SpaceManipulator, start: Array) -> None:
    x, y, _ = planar.at(start).end_effector_pose.translation.tolist()

    def reference() -> opt.Replanning:
        return opt.StepPlanner(planar, dt=0.05).track(lambda t: (x - 0.06, y + 0.08 + 0.01 * t, 0.0), 2.0)

    controller = SlidingModeController(planar)
    starts = np.array([start, planar.configuration(np.radians([3.0, 1.0, 1.0]))])
    many = simulate_many(planar, reference(), controller, 0.01, starts, jobs=2)
    for q0, found in zip(starts, many, strict=True):
        assert same(found, simulate(planar, reference(), controller, 0.01, q0))


def test_a_stopped_simulation_brings_its_record(
    planar: ffsms.SpaceManipulator, stepped: list[opt.Trajectory]
) -> None:
    plan = stepped[3]
    tasks = [
        {"reference": plan, "controller": SlidingModeController(planar), "dt": 0.01, "watchdog": watchdog}
        for watchdog in (None, Watchdog(joint_error=0.0))
    ]
    first, second = simulate_each(planar, tasks, jobs=2)
    assert first.error is None
    assert second.result is None
    assert isinstance(second.error, SimulationStopped)
    assert len(second.error.tracking.t) >= 1
    (missing,) = simulate_each(planar, [{"reference": plan}], jobs=1)
    assert isinstance(missing.error, InvalidValue)


class NotPortable(Exception):
    """An error whose class cannot be made again from its arguments."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def work(shared: int, task: int) -> int:
    """Adds; does what nobody wants for some numbers."""
    if task == 13:
        raise NotPortable(1, 3)
    if task == 66:
        os._exit(1)
    return shared + task


def test_a_process_that_dies_fails_its_own_task_only() -> None:
    tasks = [*range(10), 66, *range(20, 30), 13, 31]
    found = list(outcomes(work, 100, tasks, jobs=2))
    assert [outcome.index for outcome in found] == list(range(len(tasks)))
    for task, outcome in zip(tasks, found, strict=True):
        if task in (13, 66):
            assert isinstance(outcome.error, TaskError)
        else:
            assert outcome == Outcome(outcome.index, 100 + task)
    assert "died" in str(found[10].error)
    assert "NotPortable: 1 and 3" in str(found[21].error)


def test_chunks_grow_and_keep_the_order() -> None:
    found = list(outcomes(work, 1000, range(100, 2000), jobs=2))
    assert [outcome.result for outcome in found] == list(range(1100, 3000))


SCRIPT = """
import ffsms_pin as ffsms, numpy as np
from ffsms_pin import opt
sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([1, 1, 1]))
print("ready", flush=True)
for k, _ in enumerate(opt.plan_each(sms, ((q0, [0.8, 0.5, 0.0], 6.0) for _ in range({count})), jobs=2)):
    print("plan", k, flush=True)
print("end", flush=True)
"""


def test_a_plain_script_needs_no_guard_and_may_be_interrupted(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(count=2))
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout.split("\n") == ["ready", "plan 0", "plan 1", "end", ""], done.stderr
    assert done.stderr == ""

    script.write_text(SCRIPT.format(count=100_000))
    process = subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # What runs in the background of a shell has it that Ctrl-C is for nobody.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    while process.stdout.readline() != "plan 1\n":
        assert process.poll() is None
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of them
    _, errors = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    assert errors.count("Traceback") == 1
    assert errors.rstrip().endswith("KeyboardInterrupt")
    # No process of the group is left.
    for _ in range(100):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("workers outlived the interrupt")
