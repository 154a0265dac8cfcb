"""The same input gives the same bits, whatever the number of processes and of BLAS threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from scipy.linalg import lapack
from threadpoolctl import threadpool_info, threadpool_limits

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.threads import one_blas_thread

HERE = Path(__file__).parent


def blas_threads() -> list[int]:
    """How many threads each BLAS library uses at present."""
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def found(folder: Path, threads: int, jobs: int, *more: str) -> dict[str, Any]:
    """The digests of a fresh process with so many BLAS threads."""
    names = ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM")
    counts = {f"{name}_NUM_THREADS": str(threads) for name in names}
    path = os.pathsep.join([str(HERE.parent), str(HERE), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, str(HERE / "bits.py"), str(jobs), str(folder), *more]
    environment = {**os.environ, **counts, "PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """With one BLAS thread, in one process, by `plan` and `simulate` themselves."""
    return found(tmp_path_factory.mktemp("one"), 1, 0)


@pytest.mark.parametrize(("threads", "jobs"), [(2, 1), (4, 2)])
def test_threads_and_processes_change_no_bit(
    one: dict[str, Any], tmp_path: Path, threads: int, jobs: int
) -> None:
    assert found(tmp_path, threads, jobs) == one


def test_without_the_limit_the_bits_depend_on_the_threads(one: dict[str, Any], tmp_path: Path) -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("with one core there is one BLAS thread")
    if found(tmp_path, 2, 0, "without")["plans"] == one["plans"]:
        pytest.skip("two threads of this machine's BLAS round as one does")


class Seen(opt.Term):
    """A term that looks at the number of BLAS threads and asks for nothing."""

    name = "seen"

    def __init__(self) -> None:
        self.threads: set[int] = set()

    def residual(self, motions: opt.Motions) -> list[opt.Residual | opt.JointResidual]:
        """None, but look."""
        self.threads.update(blas_threads())
        return []


def test_one_thread_inside_and_as_many_as_before_afterwards(planar: ffsms.SpaceManipulator) -> None:
    seen, q0 = Seen(), planar.configuration([0.4, 0.7, -0.5])
    assert lapack.dposv is not None  # scipy's library is loaded: it counts as well
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        problem = opt.Problem(planar, q0, [0.75, 0.5, 0.0], 3.0, 0.05, terms=[opt.Coupling(), seen])
        opt.solve(problem)
        assert seen.threads == {1}
        assert blas_threads() == before
        with pytest.raises(ffsms.errors.InvalidValue, match="method"):
            opt.plan(planar, q0, [0.75, 0.5, 0.0], method="none")
        assert blas_threads() == before


def test_a_call_that_ends_leaves_the_limit_to_those_that_go_on() -> None:
    inside, leave = threading.Event(), threading.Event()

    def other() -> None:
        with one_blas_thread():
            inside.set()
            leave.wait(10.0)

    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        thread = threading.Thread(target=other)
        with one_blas_thread():
            thread.start()
            assert inside.wait(10.0)
        assert set(blas_threads()) == {1}  # the other call came second and has not ended
        leave.set()
        thread.join()
        assert blas_threads() == before
