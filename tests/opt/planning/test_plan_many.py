"""Plans and simulations in several processes: identical bits, kept order and isolated failures."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from processes import wait_until

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import Impedance, SlidingModeController
from ffsms_pin.errors import (
    FfsmsError,
    InvalidValue,
    SimulationDiverged,
    TaskError,
    TasksFailed,
    UnknownOption,
)
from ffsms_pin.processes import map_in_processes
from ffsms_pin.simulation import Conditions, Sensors, perturb, simulate, simulate_many

Array = NDArray[np.float64]
Refused = Callable[..., FfsmsError]
TARGETS = [(1.0, 0.15, 0.0), (0.45, 0.75, 0.0), (0.9, -0.3, 0.0), (0.8, 0.5, 0.0)]
DURATIONS = [8.0, 12.0, 8.0, 6.0]


def equal_results(a: Any, b: Any) -> bool:
    """Return whether all fields have equal bits, except the problem, which has a copy of the robot."""
    names = [field.name for field in fields(a) if field.name != "problem"]
    return all(equal_bits(getattr(a, name), getattr(b, name)) for name in names)


def equal_bits(first: Any, other: Any) -> bool:
    """Return whether arrays have equal bits and dictionaries equal entries in equal order."""
    if isinstance(first, np.ndarray):
        same_kind = first.dtype == other.dtype and first.shape == other.shape
        return bool(same_kind and first.tobytes() == other.tobytes())
    if isinstance(first, dict):
        return list(first) == list(other) and all(equal_bits(first[key], other[key]) for key in first)
    return bool(first == other)


@pytest.fixture(scope="module")
def start(planar: ffsms.SpaceManipulator) -> Array:
    return planar.configuration(np.radians([1.0, 1.0, 1.0]))


@pytest.fixture(scope="module")
def single_plans(planar: ffsms.SpaceManipulator, start: Array) -> list[opt.Trajectory]:
    """The plans to all targets, each by `opt.plan`."""
    return [opt.plan(planar, start, *task) for task in zip(TARGETS, DURATIONS, strict=True)]


@pytest.fixture(scope="module")
def stepped(planar: ffsms.SpaceManipulator, start: Array) -> list[opt.Trajectory]:
    """The plans to all targets by single steps."""
    return [opt.plan(planar, start, target, 6.0, method="step") for target in TARGETS]


@pytest.mark.parametrize("jobs", [1, 2])
def test_plan_many_gives_the_bits_of_plan(
    planar: ffsms.SpaceManipulator, start: Array, single_plans: list[opt.Trajectory], jobs: int
) -> None:
    shares: list[float] = []
    results = opt.plan_many(planar, start, TARGETS, DURATIONS, jobs=jobs, progress=shares.append)
    for expected, result in zip(single_plans, results, strict=True):
        assert equal_results(result, expected)
        assert not result.q.flags.writeable
    assert shares == [0.25, 0.5, 0.75, 1.0]


def test_plan_many_with_seven_joints_and_poses(panda_like: ffsms.SpaceManipulator) -> None:
    sms = panda_like
    joints = [np.full(7, 0.3), np.full(7, 0.4)]
    starts = [sms.configuration(row) for row in joints]
    pose = sms.at(sms.configuration(np.full(7, 0.5))).end_effector_pose
    results = opt.plan_many(sms, starts, pose, 6.0, dt=0.05, jobs=2, method="step", collision="off")
    for q0, result in zip(starts, results, strict=True):
        assert equal_results(result, opt.plan(sms, q0, pose, 6.0, 0.05, method="step", collision="off"))
    mixed = opt.plan_many(sms, starts, [pose, pose.translation], 6.0, 0.05, jobs=2, method="step")
    assert np.isfinite(mixed[0].target_rotation).all()
    assert np.isnan(mixed[1].target_rotation).all()


def test_plan_many_accepts_goals_and_functions(planar: ffsms.SpaceManipulator, start: Array) -> None:
    """Motions may share a goal, a list may mix goals and positions, and a function of time is a goal."""
    goals = [opt.Position(TARGETS[0]), TARGETS[1]]
    results = opt.plan_many(planar, start, goals, 6.0, jobs=2, method="step")
    for goal, result in zip(goals, results, strict=True):
        assert equal_results(result, opt.plan(planar, start, goal, 6.0, method="step"))
    shared = opt.plan_many(planar, [start, start], goals[0], 6.0, jobs=1, method="step")
    assert equal_results(shared[0], results[0])
    assert equal_results(shared[1], results[0])
    (moving,) = opt.plan_many(planar, [start], moving_target, 6.0, dt=0.05, jobs=1)
    assert equal_results(moving, opt.plan(planar, start, moving_target, 6.0, dt=0.05))


def moving_target(t: float) -> Array:
    return np.array([0.8 + 0.01 * t, 0.5, 0.0])


@pytest.fixture(scope="module")
def panda_like() -> ffsms.SpaceManipulator:
    return ffsms.load("space_arm_7")


def test_a_single_start_and_target_give_one_plan(
    planar: ffsms.SpaceManipulator, start: Array, stepped: list[opt.Trajectory]
) -> None:
    (result,) = opt.plan_many(planar, start, TARGETS[0], 6.0, method="step")
    assert equal_results(result, stepped[0])
    assert opt.plan_many(planar, start, [], 6.0) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failure_is_reported_by_index_and_other_results_are_kept(
    planar: ffsms.SpaceManipulator, start: Array, stepped: list[opt.Trajectory], jobs: int
) -> None:
    starts = [start, planar.configuration([0.0, 3.1, 0.0]), start]
    with pytest.raises(
        TasksFailed, match=r"1 of 3 tasks failed, the first at index 1 \(InvalidValue: q0"
    ) as e:
        opt.plan_many(planar, starts, TARGETS[:3], 6.0, jobs=jobs, method="step")
    assert list(e.value.failures) == [1]
    assert isinstance(e.value.failures[1], InvalidValue)
    assert e.value.results[1] is None
    for i in (0, 2):
        assert equal_results(e.value.results[i], stepped[i])


def test_wrong_arguments_are_refused_before_any_process_starts(
    planar: ffsms.SpaceManipulator, start: Array, refused: Refused
) -> None:
    def plan_many(*arguments: Any, **options: Any) -> Any:
        return opt.plan_many(planar, *arguments, **options)

    refused(lambda: plan_many(start, TARGETS, [6.0, 7.0]), InvalidValue, "4 of target", "2 of duration")
    refused(lambda: plan_many(start, np.zeros((2, 2, 3))), InvalidValue, "target")
    refused(lambda: plan_many(start, TARGETS, jobs=0), InvalidValue, "jobs")
    refused(lambda: plan_many(start, TARGETS, jobs=True), InvalidValue, "jobs")
    refused(lambda: plan_many(start, TARGETS, colision="off"), UnknownOption, "did you mean 'collision'?")
    refused(lambda: simulate_many(planar, None, None, integrate="rk4"), UnknownOption, "integrate")
    refused(lambda: simulate_many(planar, [1, 2], [1, 2, 3]), InvalidValue, "2 of reference")


@pytest.mark.slow
@pytest.mark.long
def test_simulate_many_gives_the_bits_of_simulate(
    planar: ffsms.SpaceManipulator, stepped: list[opt.Trajectory]
) -> None:
    plan = stepped[3]
    controller = Impedance(planar)  # a controller with internal state
    plants = [perturb(planar, arm_mass=factor) for factor in (0.9, 1.0, 1.1)]
    noisy = [Conditions(sensors=Sensors(joint_noise=1e-6, seed=seed)) for seed in range(3)]
    results = simulate_many(planar, plan, controller, 5e-3, plant=plants, conditions=noisy, jobs=2)
    serial = ffsms.simulate_many(planar, plan, controller, 5e-3, plant=plants, conditions=noisy, jobs=1)
    for plant, conditions, result, other in zip(plants, noisy, results, serial, strict=True):
        expected = simulate(planar, plan, controller, 5e-3, plant=plant, conditions=conditions)
        assert equal_results(result, expected)
        assert equal_results(other, expected)
        assert not result.tau.flags.writeable


@dataclass
class Moving:
    """A moving target that can be pickled, unlike a nested function."""

    x: float
    y: float

    def __call__(self, t: float) -> tuple[float, float, float]:
        """Return the position at time t."""
        return self.x, self.y + 0.01 * t, 0.0


def test_rows_of_starts_and_replanning_references(planar: ffsms.SpaceManipulator, start: Array) -> None:
    x, y, _ = planar.at(start).end_effector_pose.translation.tolist()

    def reference() -> opt.Replanning:
        return opt.StepPlanner(planar, dt=0.05).track(Moving(x - 0.06, y + 0.08), 2.0)

    controller = SlidingModeController(planar)
    starts = np.array([start, planar.configuration(np.radians([3.0, 1.0, 1.0]))])
    results = simulate_many(planar, reference(), controller, 0.01, starts, jobs=2)
    for q0, result in zip(starts, results, strict=True):
        assert equal_results(result, simulate(planar, reference(), controller, 0.01, q0))


def test_a_diverged_simulation_keeps_its_record(
    planar: ffsms.SpaceManipulator, stepped: list[opt.Trajectory]
) -> None:
    law = SlidingModeController(planar, Gamma=1e5, torque_limit=np.inf)
    with pytest.raises(TasksFailed) as caught:
        simulate_many(planar, [stepped[3]] * 2, law, 0.01, jobs=2, conditions=Conditions(guards=None))
    for error in caught.value.failures.values():
        assert isinstance(error, SimulationDiverged)
        assert len(error.tracking.t) >= 1
    stopped = simulate_many(planar, [stepped[3]] * 2, law, 0.01, jobs=2)
    assert all(record.stopped for record in stopped)


def work(task: int) -> int:
    """Return task + 100; end the process if the task is 66."""
    if task == 66:
        os._exit(1)
    return 100 + task


def test_results_keep_their_order() -> None:
    shares: list[float] = []
    assert map_in_processes(work, range(100, 300), 2, shares.append) == list(range(200, 400))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_dead_process_and_an_unpicklable_task_raise_task_errors(refused: Refused) -> None:
    refused(lambda: map_in_processes(work, [1, 66, 2], jobs=2), TaskError, "died", "__main__", "jobs=1")
    refused(lambda: map_in_processes(lambda task: task, [1, 2], jobs=2), TaskError, "cannot be sent")
    assert map_in_processes(lambda task: task, [1, 2], jobs=1) == [1, 2]


SCRIPT = """
import ffsms_pin as ffsms, numpy as np
from ffsms_pin import opt
sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([1, 1, 1]))
if __name__ == "__main__":
    print("ready", flush=True)
    report = lambda share: print("plan", flush=True)
    opt.plan_many(sms, q0, [[0.8, 0.5, 0.0]] * {count}, 6.0, jobs=2, progress=report)
    print("end", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent", ["SIGTERM", *(pytest.param(name, marks=pytest.mark.long) for name in ("SIGINT", "SIGKILL"))]
)
def test_a_script_that_ends_early_leaves_no_process(tmp_path: Path, sent: str) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(count=100_000))
    process = subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A process in the background of a shell ignores SIGINT by default.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    assert process.stdout.readline() == "plan\n"
    if sent == "SIGINT":
        os.killpg(process.pid, signal.SIGINT)  # a terminal signals the whole group
    else:
        process.send_signal(getattr(signal, sent))
    _, errors = process.communicate(timeout=60)
    assert process.returncode == -getattr(signal, sent)
    if sent == "SIGINT":
        assert errors.count("Traceback") == 1, errors
        assert errors.rstrip().endswith("KeyboardInterrupt")

    def group_ended() -> bool:
        """Return whether no process of the group is left."""
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return True
        return False

    assert wait_until(group_ended, 5.0), "workers outlived their parent"


@pytest.mark.slow
def test_a_dead_worker_with_tasks_left_raises_an_error(tmp_path: Path) -> None:
    """Unread tasks must not block the end of the script."""
    script = tmp_path / "script.py"
    script.write_text(
        "import os\n"
        "from ffsms_pin.errors import TaskError\n"
        "from ffsms_pin.processes import map_in_processes\n"
        "def die(task):\n    os._exit(1)\n"
        'if __name__ == "__main__":\n'
        "    try:\n        map_in_processes(die, [bytes(50_000 + i) for i in range(300)], jobs=2)\n"
        "    except TaskError as error:\n        print('died' in str(error))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "True\n", done.stderr
