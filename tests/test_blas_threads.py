"""Test that plans use one BLAS thread and then restore the previous number."""

from __future__ import annotations

import threading

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.threads import one_blas_thread


def blas_threads() -> list[int]:
    """Return the number of threads that each BLAS library uses at present."""
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


class Seen(opt.Term):
    """A term without cost that records the number of BLAS threads."""

    name = "seen"

    def __init__(self) -> None:
        self.threads: set[int] = set()

    def residual(self, motions: opt.Rollouts) -> list[opt.Variable]:
        """Record the number of threads; return no residual."""
        self.threads.update(blas_threads())
        return []


def test_plans_use_one_blas_thread_and_restore_the_previous_number(planar: ffsms.SpaceManipulator) -> None:
    seen, q0 = Seen(), planar.configuration([0.4, 0.7, -0.5])
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        problem = opt.Problem(planar, q0, [0.75, 0.5, 0.0], 3.0, 0.05, terms=[opt.Coupling(), seen])
        seen.threads.clear()  # the constructor of the problem evaluates its parts
        opt.solve(problem)
        assert seen.threads == {1}
        assert blas_threads() == before
        with pytest.raises(ffsms.errors.InvalidValue, match="method"):
            opt.plan(planar, q0, [0.75, 0.5, 0.0], method="none")
        assert blas_threads() == before


def test_calls_that_overlap_restore_the_number_of_threads() -> None:
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
            assert set(blas_threads()) == {1}
        leave.set()
        thread.join()
        assert blas_threads() == before
