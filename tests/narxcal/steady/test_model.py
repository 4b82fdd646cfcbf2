"""The envelope, opening by kind, storing any model, and what is run only with trust."""

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.function import SteadyCallable
from narxcal.steady.model import (
    Envelope,
    SteadyOptions,
    SteadyStateModel,
    StorableSteadyState,
    checked_inputs,
    stored,
)
from narxcal.steady.opening import open_steady, steady_from_json, steady_to_json
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ConfigError, ModelError

MAKER = (("TRA_deg", "Mach"), ("N1_pct",))


class Unstorable:
    input_names = ("TRA_deg",)
    output_names = ("N1_pct",)

    def outputs(self, inputs):
        return inputs

    def inside(self, inputs):
        return np.ones(inputs.shape[:-1], dtype=bool)


def test_envelope_holds_its_border_and_not_what_lies_beyond_or_is_unknown():
    box = Envelope.of(np.array([[0.0, 10.0], [1.0, 30.0]]))
    samples = np.array([[0.0, 10.0], [1.0, 30.0], [1.1, 20.0], [0.5, 9.0], [np.nan, 20.0]])
    assert box.inside(samples).tolist() == [True, True, False, False, False]
    assert box.inside(samples[0]).shape == ()


def test_clamp_moves_to_the_nearest_value_and_leaves_nan():
    box = Envelope.of(np.array([[0.0], [1.0]]))
    np.testing.assert_array_equal(
        box.clamp(np.array([[-3.0], [0.4], [7.0], [np.nan]])), [[0.0], [0.4], [1.0], [np.nan]]
    )


def test_inputs_without_a_range_are_unbounded():
    box = Envelope.from_ranges(("TRA_deg", "Mach"), {"Mach": (0.0, 0.8)})
    assert box.inside(np.array([[1e9, 0.5], [0.0, 0.9]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        (
            {"ALT_ft": (0.0, 1.0)},
            "the envelope names 'ALT_ft', which is no input of the model. Inputs are Mach",
        ),
        ({"Mach": (0.8, 0.0)}, "channel Mach: the envelope is empty: low 0.8, high 0"),
    ],
)
def test_bad_ranges_are_refused(ranges, message):
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        Envelope.from_ranges(("Mach",), ranges)


def test_a_wrong_number_of_inputs_is_refused():
    message = "the steady-state model expects 2 inputs (TRA_deg, Mach), got 3"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        checked_inputs(np.zeros((5, 3)), ("TRA_deg", "Mach"))


def test_a_stored_table_comes_back_through_the_registry():
    table = SteadyTable((["TRA_deg"], ["N1_pct"]), [[0.0], [10.0]], [[20.0], [90.0]])
    assert isinstance(table, SteadyStateModel)
    assert isinstance(table, StorableSteadyState)
    meta, arrays = steady_to_json(table)
    assert meta["kind"] == "table"
    back = steady_from_json(meta, arrays)
    assert (back.input_names, back.output_names) == (("TRA_deg",), ("N1_pct",))
    np.testing.assert_array_equal(back.outputs(np.array([[5.0]])), [[55.0]])


def test_a_model_that_cannot_be_stored_says_so():
    message = (
        "steady-state model Unstorable cannot be stored in a bundle. "
        "Give it kind, to_arrays and from_arrays, or load it as module:function"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_to_json(Unstorable())


def test_an_unknown_kind_lists_the_known_ones():
    message = r"^unknown kind of steady-state model 'oracle'\. Known kinds: .*callable.*fmu.*table"
    with pytest.raises(ModelError, match=message):
        steady_from_json({"kind": "oracle"}, {})


def test_a_missing_part_of_a_stored_model_is_named():
    message = "the stored table has no 'points'. The bundle was altered; train it again"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        stored({}, "points", "table")


def test_a_table_beside_the_configuration(tmp_path):
    rows = "TRA_deg,Mach,N1_pct\n0,0,20\n0,1,15\n30,0,60\n30,1,55\n"
    (tmp_path / "deck.csv").write_text(rows, encoding="utf-8")
    deck = open_steady("table", "deck.csv", MAKER, tmp_path, SteadyOptions(method="pchip"))
    assert isinstance(deck, SteadyTable)
    assert deck.method == "pchip"
    np.testing.assert_allclose(deck.outputs([30.0, 0.5]), [57.5])


def test_a_function_beside_the_configuration_with_its_envelope(tmp_path):
    (tmp_path / "own_deck.py").write_text("def f(u): return u[:, :1]\n", encoding="utf-8")
    options = SteadyOptions(ranges={"TRA_deg": (0.0, 78.0)})
    deck = open_steady("callable", "own_deck:f", MAKER, tmp_path, options)
    assert isinstance(deck, SteadyCallable)
    np.testing.assert_allclose(deck.outputs([99.0, 0.5]), [78.0])


def test_an_fmu_beside_the_configuration_with_its_options(tmp_path):
    spec = spec_from_file_location("fmu_source", Path(__file__).parents[1] / "fmu_source.py")
    source = module_from_spec(spec)
    spec.loader.exec_module(source)
    source.build(tmp_path / "deck.fmu", 2)
    options = SteadyOptions(variables={"EGT_C": "ITT"}, settle_s=5.0)
    deck = open_steady("fmu", "deck.fmu", (MAKER[0], ("EGT_C",)), tmp_path, options)
    assert isinstance(deck, SteadyFmu)
    assert deck.options.settle_s == 5.0
    np.testing.assert_allclose(deck.outputs([10.0, 0.5]), [340.0])


def test_another_kind_is_refused():
    message = "unknown kind of steady-state source 'fitted'. Use table, callable or fmu"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        open_steady("fitted", "", MAKER)


TRUST = (
    "If you would run a program of its author, allow it by --trust, in Python by "
    "load_bundle(folder, trust=True)"
)


@pytest.mark.parametrize(
    ("meta", "what"),
    [
        (
            {
                "kind": "callable",
                "reference": "os:listdir",
                "file": "/x/os.py",
                "sha256": "ab" * 32,
            },
            "the Python function 'os:listdir' of /x/os.py (sha256 abababababab)",
        ),
        (
            {"kind": "fmu", "file": "/x/deck.fmu", "sha256": "cd" * 32},
            "the native code of the FMU /x/deck.fmu (sha256 cdcdcdcdcdcd)",
        ),
    ],
)
def test_what_would_run_code_is_refused_without_trust(meta, what):
    message = f"opening this model would run {what}. {TRUST}"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_from_json(meta, {})


def test_a_package_is_not_even_imported_to_find_out(tmp_path, monkeypatch):
    (tmp_path / "planted").mkdir()
    (tmp_path / "planted" / "__init__.py").write_text("raise SystemExit('was run')\n", "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    meta = {"kind": "callable", "reference": "planted.sub:f", "file": "sub.py", "sha256": ""}
    with pytest.raises(ModelError, match=r"would run the Python function 'planted\.sub:f'"):
        steady_from_json(meta, {})


def test_a_function_of_narxcal_itself_needs_no_trust():
    inputs = [
        "TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI",
    ]  # fmt: skip
    outputs = ["N1_pct", "N2_pct", "EGT_C"]
    model = open_steady("callable", "narxcal.turbofan:maker_model", (inputs, outputs))
    again = steady_from_json(*steady_to_json(model))
    assert again.output_names == tuple(outputs)


@pytest.mark.parametrize("part", ["input_names", "output_names"])
def test_names_of_a_wrong_type_are_refused(part):
    table = SteadyTable((["TRA_deg"], ["N1_pct"]), [[0.0], [10.0]], [[20.0], [90.0]])
    meta, arrays = steady_to_json(table)
    message = (
        "the names of the stored steady-state table are no list of texts. "
        "The bundle was altered; train it again"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        steady_from_json({**meta, part: [1]}, arrays)
