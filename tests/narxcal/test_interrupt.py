"""Ctrl-C is held back to a place where the work can stop, and known again whatever it became."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from numba import njit

from narxcal.interrupt import held_interrupt, is_interrupt
from narxcal.narx import NarxConfig
from narxcal.records import Record
from training.config import TrainConfig
from training.trainer import Material, fit_narx


def press():
    signal.raise_signal(signal.SIGINT)


def test_one_press_waits_for_a_place_to_stop():
    with held_interrupt() as interrupt:
        interrupt.stop_here()
        press()
        assert interrupt.asked
        with pytest.raises(KeyboardInterrupt):
            interrupt.stop_here()


def test_the_second_press_does_not_wait():
    with held_interrupt():
        press()
        with pytest.raises(KeyboardInterrupt):
            press()


def test_the_handler_is_given_back_whatever_happens():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), held_interrupt():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is before


def test_another_handler_is_left_alone():
    seen = []
    before = signal.signal(signal.SIGINT, lambda *_: seen.append("theirs"))
    try:
        with held_interrupt() as interrupt:
            press()
        assert (seen, interrupt.asked) == (["theirs"], False)
    finally:
        signal.signal(signal.SIGINT, before)


def test_outside_the_main_thread_nothing_is_held():
    asked = []

    def work():
        with held_interrupt() as interrupt:
            asked.append(interrupt.asked)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert asked == [False]


def test_an_interrupt_is_known_by_what_it_came_of():
    compiled, late = SystemError("compiled"), ValueError("while it was handled")
    compiled.__cause__, late.__context__ = KeyboardInterrupt(), compiled
    assert is_interrupt(compiled)
    assert is_interrupt(late)
    assert is_interrupt(KeyboardInterrupt())
    assert not is_interrupt(SystemError("compiled"))
    assert not is_interrupt(None)


@njit
def spin(values):
    total = 0.0
    for _ in range(1000):
        for value in values:
            total += value
    return values * total


def test_signals_that_fall_into_a_compiled_loop_are_known_or_held():
    values = np.ones(100)
    spin(values)
    for _ in range(20):
        sender = threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT))
        with held_interrupt() as interrupt:
            sender.start()
            deadline = time.monotonic() + 60.0
            while not interrupt.asked:
                spin(values)
                assert time.monotonic() < deadline
        sender.join()


def test_training_ends_between_steps_and_keeps_the_best():
    u = np.sin(0.3 * np.arange(200.0))[:, None]
    y = np.tanh(np.cumsum(u, axis=0) / 4)
    seen = []

    def watch(progress):
        seen.append(progress.iteration)
        if len(seen) == 2:
            press()

    train = TrainConfig(horizons_s=(20.0, 0.0), iterations=(20, 20))
    result = fit_narx(
        Material([Record(u, y)], [], 1.0), NarxConfig(lags=1, taps=(0,), hidden=3), train, watch
    )
    assert seen == [1, 2]
    assert result.status.startswith("interrupted")
    assert len(result.history) == 2
