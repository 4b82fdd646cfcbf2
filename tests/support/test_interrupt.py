"""Ctrl-C is held back to a place where the work can stop, and known again whatever it became."""

import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from narxcal.support.interrupt import held_interrupt, is_interrupt, safe_interrupt
from training.config import TrainConfig
from training.dynamics.network import Material, fit_narx


def press():
    signal.raise_signal(signal.SIGINT)


def test_one_press_waits_for_a_place_to_stop():
    with held_interrupt() as interrupt:
        interrupt.stop_here()
        press()
        assert interrupt.requested
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
        assert (seen, interrupt.requested) == (["theirs"], False)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_safe_interrupt_is_one_and_its_handler_is_taken_back():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), safe_interrupt():
        press()
    assert signal.getsignal(signal.SIGINT) is before
    with safe_interrupt(), held_interrupt() as interrupt:  # the one within the other
        press()
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            press()


def test_what_comes_of_a_press_that_c_code_swallowed_is_known_for_one():
    with safe_interrupt():
        with pytest.raises(KeyboardInterrupt):
            press()
        assert is_interrupt(ValueError("cannot be parsed"))
        assert not is_interrupt(None)
    with safe_interrupt():
        assert not is_interrupt(ValueError("cannot be parsed"))


def test_what_ignores_the_signal_goes_on_ignoring_it():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with safe_interrupt():
            press()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_outside_the_main_thread_nothing_is_held():
    asked = []

    def work():
        with held_interrupt() as interrupt:
            asked.append(interrupt.requested)

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


# Compiled functions within which SIGINT arrives, by what they hand over.
COMPILED = """
import ctypes
from typing import NamedTuple
import numpy as np
from numba import njit

press = getattr(ctypes.CDLL(None), "raise")
press.argtypes, press.restype = [ctypes.c_int], ctypes.c_int

class Named(NamedTuple):
    value: float
    values: np.ndarray

@njit
def array(x, number):
    press(number)
    return 2.0 * x

@njit
def several(x, number):
    press(number)
    return 2.0 * x, x, True

@njit
def named(x, number):
    press(number)
    return Named(x[0], 2.0 * x)

@njit
def nested(x, number):
    press(number)
    return Named(x[0], 2.0 * x), Named(1.0, x)
"""
GUARDED = """
import signal, time
from narxcal.support.interrupt import held_interrupt, safe_interrupt

for call in (array, several, named, nested):
    x = np.ones(3)
    call(x, 0)  # no signal
    with safe_interrupt():
        for _ in range(20):
            try:
                call(x, signal.SIGINT)
                while True:
                    time.sleep(0.001)
            except KeyboardInterrupt as stop:
                assert stop.__cause__ is stop.__context__ is None
    with held_interrupt() as interrupt:
        call(x, signal.SIGINT)
        assert interrupt.requested
    print(call.__name__, flush=True)
"""


@pytest.mark.slow
def test_a_signal_that_arrives_inside_compiled_code_is_a_keyboard_interrupt_behind_it():
    done = subprocess.run(
        [sys.executable, "-c", COMPILED + GUARDED],
        capture_output=True, text=True, timeout=120.0, check=False,
    )  # fmt: skip
    assert done.stdout.split() == ["array", "several", "named", "nested"]
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
def test_the_virtual_engine_hands_python_nothing_that_a_signal_could_break():
    code = (
        "import numpy as np\n"
        "from narxcal.turbofan import VirtualEngine\n"
        "from numba.core import serialize\n"
        "engine = VirtualEngine('business_jet')\n"
        "lever = np.full(9, 40.0)\n"
        "inputs = {name: 0.0 * lever for name in engine.input_names} | {'TRA_deg': lever}\n"
        "engine.simulate(inputs, 0.1)\n"
        "engine.outputs(np.stack(list(inputs.values()), axis=-1))\n"
        "print({kind.__name__ for kind in serialize._unpickled_memo.values()})\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120.0, check=False
    )
    assert (done.stdout, done.stderr) == ("{'ndarray'}\n", "")


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
