"""A function as steady-state model: shapes, envelope, reference and hash."""

import re
import sys

import joblib
import numpy as np
import pytest

from narxcal.steady.function import Cached, SteadyCallable
from narxcal.steady.model import SteadyStateModel
from narxcal.steady.opening import steady_from_json, steady_to_json
from narxcal.support.errors import ConfigError, ModelError

NAMES = (("TRA_deg", "Mach"), ("N1_pct",))
SOURCE = """
from __future__ import annotations
from dataclasses import dataclass

@dataclass
class Deck:
    gain: float

DECK = Deck(2.0)
answer = 42

def outputs(inputs):
    return 20.0 + DECK.gain * inputs[:, :1] - inputs[:, 1:]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "maker_deck.py").write_text(SOURCE, encoding="utf-8")
    return tmp_path


def load(folder, **more):
    return SteadyCallable.load("maker_deck:outputs", NAMES, folder=folder, **more)


def test_a_function_answers_any_leading_axes_and_nan_with_nan(folder):
    model = load(folder)
    assert isinstance(model, SteadyStateModel)
    inputs = np.zeros((2, 3, 2))
    inputs[..., 0] = 10.0
    inputs[1, 1, 1] = np.nan
    found, held = model.outputs(inputs), model.inside(inputs)
    assert found.shape == (2, 3, 1)
    assert np.isnan(found[1, 1]).all()
    assert not held[1, 1]
    assert held.sum() == 5
    assert found[0, 0, 0] == 40.0
    assert model.outputs([10.0, 0.0]).tolist() == [40.0]


def test_the_function_never_sees_inputs_outside_its_envelope():
    seen = []

    def spy(inputs):
        seen.append(inputs.copy())
        return inputs[:, :1]

    model = SteadyCallable(spy, NAMES, {"TRA_deg": (0.0, 78.0)})
    inputs = np.array([[-5.0, 0.3], [90.0, 0.3], [np.inf, 0.1], [40.0, np.nan]])
    assert model.outputs(inputs)[:3, 0].tolist() == [0.0, 78.0, 78.0]
    assert not model.inside(inputs).any()
    assert np.concatenate(seen).shape == (3, 2)


def test_an_empty_log_does_not_call_the_function(folder):
    assert load(folder).outputs(np.zeros((0, 2))).shape == (0, 1)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (
            lambda inputs: inputs[:, 0],
            "steady-state model function returned (3,), expected (3, 1)",
        ),
        (
            lambda _: [["idle"]] * 3,
            (
                "steady-state model function failed on inputs (3, 2): could not convert string to "
                "float: 'idle'. It takes one array (samples, inputs) and returns (samples, outputs)"
            ),
        ),
    ],
)
def test_a_function_that_returns_something_else_is_refused(function, message):
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        SteadyCallable(function, NAMES).outputs(np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("maker_deck", "'maker_deck' is no reference to a function. Write it as module:function"),
        ("a b:f", "'a b:f' is no reference to a function. Write it as module:function"),
        (
            "no_such_deck:f",
            (
                "'no_such_deck:f': there is no module 'no_such_deck'. "
                "Install it, or put no_such_deck.py into FOLDER"
            ),
        ),
        (
            "no.such:f",
            (
                "'no.such:f': there is no module 'no.such'. "
                "Install it, or put no/such.py into FOLDER"
            ),
        ),
        (
            "maker_deck:missing",
            "'maker_deck:missing': the module has no function 'missing'",
        ),
        ("maker_deck:answer", "'maker_deck:answer': the module has no function 'answer'"),
    ],
)
def test_a_bad_reference_is_refused(folder, reference, message):
    message = "steady-state model " + message.replace("FOLDER", str(folder))
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        SteadyCallable.load(reference, NAMES, folder=folder)


def test_a_module_that_does_not_import_is_refused_each_time(folder):
    file = folder / "maker_deck.py"
    file.write_text("import no_such_package_at_all\n", encoding="utf-8")
    message = (
        f"{file}: the module cannot be imported: ModuleNotFoundError: "
        f"No module named 'no_such_package_at_all'. Install it, or put it into {folder}"
    )
    for _ in range(2):
        with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
            load(folder)


def test_an_installed_module_needs_no_folder():
    model = SteadyCallable.load("numpy:sqrt", (["Mach"], ["N1_pct"]))
    assert model.outputs([[4.0]]).tolist() == [[2.0]]


def test_an_installed_module_goes_before_a_file_and_a_file_hides_no_module(folder):
    (folder / "json.py").write_text("def outputs(inputs): return inputs\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="the module has no function 'outputs'"):
        SteadyCallable.load("json:outputs", NAMES, folder=folder)
    load(folder)
    assert "maker_deck" not in sys.modules


def test_a_stored_function_comes_back_with_its_envelope(folder):
    model = load(folder, ranges={"TRA_deg": (0.0, 78.0)})
    meta, arrays = steady_to_json(model)
    assert meta["kind"] == "callable"
    assert meta["reference"] == "maker_deck:outputs"
    back = steady_from_json(meta, arrays, trust=True)
    probe = np.array([[90.0, 0.5], [10.0, 0.5]])
    np.testing.assert_array_equal(back.outputs(probe), model.outputs(probe))
    assert back.inside(probe).tolist() == [False, True]


def test_a_function_that_was_changed_is_refused_and_not_run(folder):
    meta, arrays = steady_to_json(load(folder))
    file = folder / "maker_deck.py"
    file.write_text("raise SystemExit('was run')\n", encoding="utf-8")
    message = (
        f"{file}: the steady-state model 'maker_deck:outputs' is not the one the bundle was "
        "trained on. Restore the former file, or train anew"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_from_json(meta, arrays, trust=True)
    file.unlink()
    message = (
        "the steady-state model 'maker_deck:outputs' of this bundle is not installed. "
        f"Put maker_deck.py into {folder}, or install it"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_from_json(meta, arrays, trust=True)


def test_a_function_without_a_module_cannot_be_stored():
    message = (
        "a steady-state function without a module cannot be stored in a bundle. "
        "Load it as module:function"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_to_json(SteadyCallable(np.sqrt, NAMES))


def test_worker_processes_get_the_same_function(folder):
    model = load(folder, ranges={"TRA_deg": (0.0, 78.0)})
    inputs = np.array([[90.0, 0.5]])
    found = joblib.Parallel(n_jobs=2)(joblib.delayed(model.outputs)(inputs) for _ in range(2))
    np.testing.assert_array_equal(found, [model.outputs(inputs)] * 2)


def counted(most_rows=1000):
    """A function that doubles, its cache, and how many rows were evaluated each time."""
    evaluated = []

    def double(inputs):
        evaluated.append(len(inputs))
        return 2.0 * inputs

    return Cached(double, most_rows), evaluated


def log(first, rows=300):
    return first + np.arange(2.0 * rows).reshape(rows, 2)


def test_the_same_log_is_evaluated_once():
    cached, evaluated = counted()
    for _ in range(3):
        np.testing.assert_array_equal(cached(log(0.0)), 2.0 * log(0.0))
        np.testing.assert_array_equal(cached(log(1.0)), 2.0 * log(1.0))
    assert evaluated == [300, 300]


def test_logs_of_the_same_numbers_in_another_order_are_others():
    cached, evaluated = counted()
    columns = np.asfortranarray(log(0.0))
    np.testing.assert_array_equal(cached(columns), 2.0 * columns)
    np.testing.assert_array_equal(cached(columns[::-1]), 2.0 * columns[::-1])
    np.testing.assert_array_equal(cached(log(0.0)), 2.0 * log(0.0))
    assert evaluated == [300, 300]


@pytest.mark.parametrize("rows", [1, 99, 1001])
def test_samples_of_a_stream_and_logs_too_long_are_not_kept(rows):
    cached, evaluated = counted()
    for _ in range(2):
        cached(log(0.0, rows))
    assert evaluated == [rows, rows]


def test_the_one_not_used_for_longest_is_forgotten():
    cached, evaluated = counted()
    for first in (0.0, 1.0, 2.0, 0.0, 3.0, 0.0, 1.0):  # three logs fit in
        cached(log(first))
    assert evaluated == [300] * 5


def test_an_answer_cannot_be_changed():
    cached, _ = counted()
    answer = cached(log(0.0))
    with pytest.raises(ValueError, match="read-only"):
        answer += 1.0


def test_an_error_is_raised_each_time():
    def fails(inputs):
        raise RuntimeError(f"{len(inputs)} rows")

    cached = Cached(fails)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="300 rows"):
            cached(log(0.0))
