"""Fitted steady-state curves: the corrections, the splines, the blending, the build scatter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.atmosphere import air_state
from narxcal.steady.fitted import FittedSteadyState, Layout, i_splines
from narxcal.steady.model import Envelope
from narxcal.steady.opening import steady_from_json, steady_to_json
from narxcal.support.errors import ModelError

INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C")
OUTPUTS = ("N1_pct", "EGT_C", "FF_kgph", "FN_kN", "EPR")
KNOTS = np.linspace(0.0, 80.0, 6)
LOW, HIGH = np.array([5.0, 0.0, 0.0, -20.0]), np.array([75.0, 35000.0, 0.8, 30.0])
inside = st.tuples(*(st.floats(low, high) for low, high in zip(LOW, HIGH, strict=True)))


def layout(**changed):
    given_ = {
        "input_names": INPUTS,
        "output_names": OUTPUTS,
        "driver": "TRA_deg",
        "blend": ("Mach", "ALT_ft"),
    }
    return Layout(**{**given_, **changed})


def model(seed=0, **changed):
    parts = layout(**changed)
    rng = np.random.default_rng(seed)
    corners = 2 ** len(parts.blend)
    curve = rng.uniform(0.0, 20.0, (len(OUTPUTS), corners, 1 + len(KNOTS)))
    return FittedSteadyState(
        layout=parts,
        envelope=Envelope(LOW, HIGH),
        seen=np.array([5.0, 75.0]),
        knots=KNOTS,
        curve=curve,
        engines=("left", "right"),
        engine_curves=np.ones((2, len(OUTPUTS), 1))
        * np.eye(1 + len(KNOTS))[0]
        * [[[1.0]], [[-1.0]]],
    )


@given(at=inside, values=st.lists(st.floats(-50, 2000), min_size=5, max_size=5))
def test_corrected_parameters_come_back_as_they_were(at, values):
    parts, given_, outputs = layout(), np.array([at]), np.array([values])
    back = parts.from_corrected(given_, parts.to_corrected(given_, outputs))
    np.testing.assert_allclose(back, outputs, rtol=1e-12, atol=1e-9)


def test_corrections_are_those_of_the_textbook():
    at = np.array([40.0, 20000.0, 0.6, 10.0])
    air = air_state(20000.0, 0.6, 10.0)
    referred = layout().to_corrected(at, np.array([80.0, 500.0, 900.0, 12.0, 2.0]))
    root = np.sqrt(air.theta2)
    expected = [
        80.0 / root, 773.15 / air.theta2, 900.0 / (air.delta2 * root), 12.0 / air.delta2, 2.0
    ]  # fmt: skip
    np.testing.assert_allclose(referred, expected)


def test_at_sea_level_on_a_standard_day_nothing_is_corrected_but_the_zero_of_temperature():
    given_ = np.array([50.0, 70.0, 80.0, 90.0, 2.0])
    referred = layout().to_corrected(np.array([40.0, 0.0, 0.0, 0.0]), given_)
    expected = given_ + np.array([0.0, 273.15, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(referred, expected, rtol=2e-3)


def test_without_correction_outputs_stay_as_they_are():
    at, outputs = np.array([[40.0, 20000.0, 0.6, 10.0]]), np.array([[1.0, 2.0, 3.0, 4.0, 5.0]])
    assert np.array_equal(layout(corrected=False).to_corrected(at, outputs), outputs)


def test_fuel_flow_drives_by_the_logarithm_of_its_corrected_value():
    parts = layout(input_names=("FF_kgph", *INPUTS[1:]), driver="FF_kgph")
    at = np.array([[800.0, 20000.0, 0.5, 0.0]])
    air = air_state(20000.0, 0.5, 0.0)
    expected = np.log(800.0 / (air.delta2 * np.sqrt(air.theta2)))
    assert parts.drive(at) == pytest.approx([expected])


def test_an_input_the_model_lacks_counts_as_zero():
    short = layout(input_names=("TRA_deg", "ALT_ft"), blend=())
    same = short.to_corrected(np.array([40.0, 9000.0]), np.ones(5))
    whole = layout().to_corrected(np.array([40.0, 9000.0, 0.0, 0.0]), np.ones(5))
    assert same == pytest.approx(whole)


@given(count=st.integers(2, 9), at=st.lists(st.floats(0, 1), min_size=2, max_size=20))
def test_every_spline_rises_and_equal_ones_make_a_straight_line(count, at):
    knots = np.linspace(0.0, 1.0, count)
    z = np.sort(at)
    values = i_splines(knots)(z)
    assert values.shape == (len(z), count)
    assert (np.diff(values, axis=0) >= -1e-12).all()
    total = values.sum(axis=1)
    np.testing.assert_allclose(total - total[0], (z - z[0]) * (count - 1), atol=1e-9)


@given(at=inside, other=st.floats(5.0, 75.0), seed=st.integers(0, 9))
def test_more_driver_never_means_less_output_inside_the_envelope(at, other, seed):
    low, high = sorted((at[0], other))
    curves = model(seed)
    pair = curves.outputs(np.array([[low, *at[1:]], [high, *at[1:]]]))
    assert (pair[1] - pair[0] >= -1e-9).all()


@given(at=st.tuples(*(st.floats(-1e6, 1e6) for _ in range(4))))
def test_corner_weights_are_shares(at):
    weights = layout().corners(np.array([at]), Envelope(LOW, HIGH))
    assert weights.shape == (1, 4)
    assert (weights >= 0.0).all()
    assert weights.sum() == pytest.approx(1.0)


def test_each_engine_has_its_own_scatter_and_an_unknown_one_has_none():
    curves, at = model(corrected=False), np.array([[40.0, 0.0, 0.0, 0.0]])
    mean = curves.outputs(at)
    left, right = (curves.for_engine(name).outputs(at) for name in ("left", "right"))
    np.testing.assert_allclose(left - mean, 1.0)
    np.testing.assert_allclose(right - mean, -1.0)
    assert np.array_equal(curves.for_engine("spare").outputs(at), mean)


def test_beyond_the_knots_the_curves_are_held_and_outside():
    curves = model(corrected=False)
    at = np.array([[75.0, 0.0, 0.0, 0.0], [80.0, 0.0, 0.0, 0.0], [500.0, 0.0, 0.0, 0.0]])
    values = curves.outputs(at)
    assert np.array_equal(values[1], values[2])
    assert curves.inside(at).tolist() == [True, False, False]


def test_it_comes_back_from_json_and_arrays_as_it_was():
    curves = model().for_engine("left")
    again = steady_from_json(*steady_to_json(curves))
    at = np.random.default_rng(0).uniform(LOW, HIGH, (50, 4))
    assert np.array_equal(again.outputs(at), curves.outputs(at))
    assert np.array_equal(
        again.for_engine("right").outputs(at), curves.for_engine("right").outputs(at)
    )
    assert (again.input_names, again.output_names) == (INPUTS, OUTPUTS)


def test_a_lost_part_is_named():
    meta, arrays = steady_to_json(model())
    del arrays["knots"]
    with pytest.raises(ModelError) as error:
        steady_from_json(meta, arrays)
    assert str(error.value) == (
        "the stored steady-state model has no 'knots'. The bundle was altered; train it again"
    )
