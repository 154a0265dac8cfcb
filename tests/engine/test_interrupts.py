"""Ctrl-C ends a loop over processes wherever it comes; a program's own handlers are called as ever."""

from __future__ import annotations

import gc
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from ffsms_pin.engine import end_kept, outcomes
from ffsms_pin.engine.cluster import put_off


@pytest.fixture(autouse=True)
def _handlers_stand_again() -> Iterator[None]:
    """Python's own handler of Ctrl-C, also in the background of a shell, where it is for nobody."""
    given = signal.signal(signal.SIGINT, signal.default_int_handler)
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    yield
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    signal.signal(signal.SIGINT, given)
    end_kept()


@pytest.fixture
def own_handler() -> Iterator[list[int]]:
    """A handler of a program that takes note of Ctrl-C, and goes on."""
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    yield came
    signal.signal(signal.SIGINT, before)


class Dropped:
    """Ctrl-C comes while Python takes it apart."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)


def add(shared: int, task: int) -> int:
    return shared + task


@pytest.fixture
def pressed_in_del(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Ctrl-C comes in the fifth `__del__` of a future of Dask that the main thread drops."""
    from distributed import Future

    calls: list[int] = []
    original: Any = Future.__del__

    def drop(future: Any) -> None:
        if threading.current_thread() is threading.main_thread():
            calls.append(len(calls))
            if len(calls) == 5:
                signal.raise_signal(signal.SIGINT)
        original(future)

    monkeypatch.setattr(Future, "__del__", drop)
    return calls


def test_ctrl_c_in_a_del_of_dask_ends_the_loop(pressed_in_del: list[int]) -> None:
    found: list[Any] = []
    with pytest.raises(KeyboardInterrupt):
        found.extend(outcomes(add, 1, range(200), jobs=2))
    assert len(found) < 100
    assert len(pressed_in_del) >= 5
    assert [one.result for one in outcomes(add, 1, range(3), jobs=2)] == [1, 2, 3]


def test_an_own_handler_is_called_and_the_loop_goes_on(
    own_handler: list[int], pressed_in_del: list[int]
) -> None:
    assert [one.result for one in outcomes(add, 1, range(40), jobs=2)] == list(range(1, 41))
    assert len(pressed_in_del) >= 5
    assert own_handler == [signal.SIGINT]


def test_what_python_drops_in_a_del_comes_after_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    lost: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    thing = Dropped()
    del thing
    gc.collect()
    assert len(lost) == 1  # without the block Python drops it
    steps: list[str] = []

    def block() -> None:
        with put_off():
            thing = Dropped()
            del thing
            gc.collect()
            steps.append("block")
        steps.append("after")

    with pytest.raises(KeyboardInterrupt):
        block()
    assert steps == ["block"]
    assert len(lost) == 1


def test_sigterm_waits_too_and_handlers_that_were_set_meanwhile_stay() -> None:
    came: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: came.append(number))
    try:
        with put_off():
            signal.raise_signal(signal.SIGTERM)
            assert not came
        assert came == [signal.SIGTERM]
        with put_off():
            other = signal.signal(signal.SIGTERM, signal.SIG_IGN)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
        assert callable(other)
    finally:
        signal.signal(signal.SIGTERM, before)


def test_the_second_signal_does_not_wait() -> None:
    steps: list[str] = []

    def block() -> None:
        with put_off(lambda: steps.append("woken")):
            signal.raise_signal(signal.SIGINT)
            steps.append("first")
            signal.raise_signal(signal.SIGINT)
            steps.append("second")

    with pytest.raises(KeyboardInterrupt) as caught:
        block()
    assert steps == ["woken", "first"]
    assert caught.value.__context__ is None  # it is raised once


def test_an_error_of_the_block_does_not_hide_the_interrupt() -> None:
    def block() -> None:
        with put_off():
            signal.raise_signal(signal.SIGINT)
            raise OSError

    with pytest.raises(KeyboardInterrupt):
        block()


def test_other_threads_leave_handlers_alone() -> None:
    handlers: list[Any] = []

    def block() -> None:
        with put_off():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=block)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGINT)]
