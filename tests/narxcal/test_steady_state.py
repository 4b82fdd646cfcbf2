"""The protocol's envelope and the registry that stores any model."""

import re

import numpy as np
import pytest

from narxcal.steady.model import (
    Envelope,
    SteadyStateModel,
    StorableSteadyState,
    checked_inputs,
    steady_from_json,
    steady_to_json,
    stored,
)
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ModelError


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
