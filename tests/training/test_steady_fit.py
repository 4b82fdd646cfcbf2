"""The fit of steady-state curves: known curves come back, whatever the noise and the bleed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.atmosphere import air_at
from narxcal.steady.fitted import Layout
from narxcal.support.errors import ConfigError, DataError
from training.config import SteadyFitConfig, SteadyStateConfig
from training.steady.steady_fit import SteadySamples, fit_steady_state

LAYOUT = Layout(
    input_names=("TRA_deg", "ALT_ft", "Mach", "dT_C"),
    output_names=("N1_pct", "EGT_C"),
    driver="TRA_deg",
    blend=("Mach",),
)


def truth(inputs):
    """A curved engine whose corrected parameters are exactly one curve per Mach number."""
    z, mach = inputs[:, 0] / 80.0, inputs[:, 2]
    n1 = 25.0 + 70.0 * z**0.8 + 5.0 * mach
    egt = 600.0 + 500.0 * z**1.5 + 20.0 * mach
    return LAYOUT.from_corrected(inputs, np.column_stack([n1, egt]))


def drawn(count=600, seed=0):
    rng = np.random.default_rng(seed)
    low, high = [5.0, 0.0, 0.0, -10.0], [80.0, 30000.0, 0.8, 20.0]
    return rng.uniform(low, high, (count, 4))


def fitted(*samples, config=None, layout=LAYOUT):
    return fit_steady_state(samples, layout, config or SteadyFitConfig())


def largest_error(model, offset=0.0):
    inputs = drawn(seed=9)
    return np.abs(model.outputs(inputs) - truth(inputs) - offset).max(axis=0)


def test_a_known_curve_is_recovered():
    inputs = drawn()
    model, quality = fitted(SteadySamples(inputs, truth(inputs)))
    n1, egt = largest_error(model)
    assert n1 < 0.6
    assert egt < 6.0
    assert quality.samples == 600
    assert quality.coverage == 1.0
    assert quality.rms["N1_pct"] < 0.2


def engines(bends, count=600):
    """Samples of engines whose N1 is off by a parabola over the lever, of this height each."""
    found = []
    for number, bend in enumerate(bends):
        inputs = drawn(count, seed=number)
        x = inputs[:, 0] / 40.0 - 1.0625  # -1 to 1 over the levers
        outputs = truth(inputs)
        outputs[:, 0] += bend * (1.0 - 2.0 * x**2)
        outputs += np.random.default_rng(number).normal(size=outputs.shape) * [0.3, 3.0]
        found.append(SteadySamples(inputs, outputs, f"e{number}"))
    return found


def test_each_engine_has_a_curve_of_its_own():
    model, _ = fitted(*engines([1.5, -1.5]))
    at = np.column_stack([np.linspace(10.0, 75.0, 14), *np.zeros((3, 14))])
    apart = (model.for_engine("e0").outputs(at) - model.for_engine("e1").outputs(at))[:, 0]
    x = at[:, 0] / 40.0 - 1.0625
    np.testing.assert_allclose(apart, 3.0 * (1.0 - 2.0 * x**2), atol=0.3)


@pytest.mark.parametrize(("count", "most"), [(600, 0.12), (30, 0.3)])
def test_engines_that_do_not_differ_have_hardly_a_curve(count, most):
    """Noise of 0.3 % alone tells them apart; without a prior few samples would say ten times so."""
    model, _ = fitted(*engines([0.0, 0.0, 0.0], count))
    at = np.column_stack([np.linspace(10.0, 75.0, 14), *np.zeros((3, 14))])
    assert np.abs(model.for_engine("e0").outputs(at) - model.outputs(at))[:, 0].max() < most


def test_a_single_engine_has_no_curve_of_its_own():
    assert fitted(*engines([1.5]))[0].engine_curves.shape[0] == 0


def test_noise_averages_out():
    inputs = drawn(3000)
    noise = np.random.default_rng(1).normal(size=(3000, 2)) * [1.0, 10.0]
    model, quality = fitted(SteadySamples(inputs, truth(inputs) + noise))
    assert (largest_error(model) < [0.8, 9.0]).all()
    assert quality.rms["N1_pct"] == pytest.approx(1.0, rel=0.1)
    assert quality.rms["EGT_C"] == pytest.approx(10.0, rel=0.1)


def test_one_sample_in_five_with_bleed_does_not_bend_the_curve():
    inputs = drawn(1500)
    outputs = truth(inputs) + np.random.default_rng(1).normal(size=(1500, 2)) * [0.1, 1.0]
    outputs[::5, 1] += 40.0
    robust, _ = fitted(SteadySamples(inputs, outputs), config=SteadyFitConfig(huber=1.5))
    plain, _ = fitted(SteadySamples(inputs, outputs), config=SteadyFitConfig(huber=0.0))
    test = drawn(seed=9)
    bias = [float(np.mean((m.outputs(test) - truth(test))[:, 1])) for m in (robust, plain)]
    assert abs(bias[0]) < 1.5
    assert bias[1] > 6.0


def test_build_scatter_of_each_engine_is_found_and_the_mean_engine_has_none():
    inputs, other = drawn(800, 0), drawn(800, 1)
    samples = [
        SteadySamples(inputs, truth(inputs) - [-0.5, 0.0], "left"),
        SteadySamples(other, truth(other) - [0.5, 0.0], "right"),
    ]
    config = SteadyFitConfig(scatter=1e-6)
    model, _ = fitted(*samples, config=config)
    assert model.engines == ("left", "right")
    at = drawn(seed=9)
    gap = model.for_engine("left").outputs(at) - model.for_engine("right").outputs(at)
    assert gap[:, 0].mean() == pytest.approx(1.0, abs=0.05)
    assert np.abs(gap[:, 1]).max() < 0.5
    mean = (model.outputs(at) - truth(at))[:, 0]
    assert abs(mean.mean()) < 0.05


def test_a_single_engine_gets_no_scatter():
    inputs = drawn(100)
    model, _ = fitted(SteadySamples(inputs, truth(inputs), "left"))
    assert model.engines == ()
    assert np.array_equal(model.for_engine("left").outputs(inputs), model.outputs(inputs))


@given(seed=st.integers(0, 10**6), huber=st.sampled_from([0.0, 2.0]))
def test_whatever_the_samples_the_curve_of_a_speed_never_falls(seed, huber):
    """That of a temperature may: where the samples, or their noise, clearly say so."""
    rng = np.random.default_rng(seed)
    inputs = drawn(60, seed)
    outputs = rng.normal(size=(60, 2)) * [30.0, 300.0]
    model, _ = fitted(SteadySamples(inputs, outputs), config=SteadyFitConfig(huber=huber))
    sweep = np.tile(inputs[0], (50, 1))
    sweep[:, 0] = np.linspace(-20.0, 120.0, 50)
    assert (np.diff(model.outputs(sweep)[:, 0]) >= -1e-7).all()


def test_a_masked_output_costs_only_itself():
    inputs = drawn()
    outputs = truth(inputs)
    masked = outputs.copy()
    masked[::2, 0] = np.nan
    whole, _ = fitted(SteadySamples(inputs, outputs))
    part, _ = fitted(SteadySamples(inputs, masked))
    assert np.array_equal(part.curve[1], whole.curve[1])
    assert np.isfinite(part.curve).all()
    assert largest_error(part)[0] < 0.8


def test_beyond_the_samples_a_curve_goes_on_straight_for_their_range_and_then_stands():
    inputs = drawn()
    model, _ = fitted(SteadySamples(inputs, truth(inputs)))
    low, span = inputs[:, 0].min(), np.ptp(inputs[:, 0])
    sweep = np.zeros((6, 4))
    sweep[:, 0] = low + span * np.array([-2.0, -1.3, -0.8, 1.5, 1.75, 2.0])
    n1, egt = model.outputs(sweep).T
    assert n1[0] == pytest.approx(n1[1])
    assert n1[1] < n1[2]
    assert n1[4] - n1[3] == pytest.approx(n1[5] - n1[4])
    assert egt[1] == pytest.approx(egt[2])  # a temperature may turn
    assert egt[4] == pytest.approx(egt[5])
    assert not model.inside(sweep).any()


def test_how_far_a_curve_goes_on_changes_nothing_within_the_samples():
    inputs, other = drawn(300, 0), drawn(300, 1)
    samples = [
        SteadySamples(inputs, truth(inputs) - inputs[:, :1] / 80.0, "left"),
        SteadySamples(other, truth(other), "right"),
    ]
    near, far = (fitted(*samples, config=SteadyFitConfig(reach=reach))[0] for reach in (0.15, 1.0))
    at = drawn(seed=9)
    expected = near.for_engine("left").outputs(at)
    np.testing.assert_allclose(far.for_engine("left").outputs(at), expected, rtol=1e-9)


def test_corrected_curves_are_vouched_for_in_air_they_were_not_fitted_in_but_not_at_any_mach():
    inputs = drawn()
    model, _ = fitted(SteadySamples(inputs, truth(inputs)))
    for conditions, vouched_for in (
        ([40.0, 15000.0, 0.4, 5.0], True),
        ([40.0, 40000.0, 0.4, 30.0], True),
        ([40.0, 15000.0, 0.9, 5.0], False),
        ([40.0, 75000.0, 0.4, 5.0], False),
        ([85.0, 15000.0, 0.4, 5.0], False),
    ):
        assert model.inside(conditions) == vouched_for


def constant_lever():
    inputs = drawn()
    inputs[:, 0] = 40.0
    return SteadySamples(inputs, truth(inputs))


def dark_output():
    inputs = drawn()
    outputs = truth(inputs)
    outputs[:, 1] = np.nan
    return SteadySamples(inputs, outputs)


TOO_FEW = (
    "channel TRA_deg: expected at least 50 samples to fit curves to, found 49. "
    "Add logs, or set [steady_state] kind to table, callable or fmu"
)
STANDS = (
    "channel TRA_deg: the driving channel stands at 40 in all samples, so no curve can be "
    "fitted. Add logs at other power settings"
)
DARK = (
    "channel EGT_C: the output is masked in all samples, so no curve can be fitted. "
    "Take it out of [narx] outputs, or add logs that hold it"
)


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        (SteadySamples(drawn(49), truth(drawn(49))), TOO_FEW),
        (constant_lever(), STANDS),
        (dark_output(), DARK),
    ],
)
def test_too_little_to_fit_to_is_refused(samples, message):
    with pytest.raises(DataError) as error:
        fitted(samples)
    assert str(error.value) == message


def test_corrections_need_an_altitude():
    layout = Layout(input_names=("TRA_deg",), output_names=("N1_pct",), driver="TRA_deg")
    with pytest.raises(ConfigError) as error:
        fitted(SteadySamples(drawn()[:, :1], drawn()[:, :1]), layout=layout)
    assert str(error.value) == (
        "corrected parameters need ALT_ft among [steady_state] inputs. "
        "Add it, or set corrected = false"
    )


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "table"}, "kind 'table' needs a source"),
        (
            {"inputs": ["TRA_deg", "ALT_ft"], "blend": ["Mach"]},
            "blend names 'Mach', which is no input",
        ),
    ],
)
def test_a_section_that_contradicts_itself_is_refused(table, message):
    with pytest.raises(ConfigError) as error:
        SteadyStateConfig.parse(table)
    assert message in str(error.value)


def test_how_a_declared_ratio_depends_on_the_air_is_found_from_the_samples():
    rng = np.random.default_rng(4)
    inputs = np.column_stack([rng.uniform(20.0, 80.0, 800), rng.uniform(0.0, 20000.0, 800)])
    delta = air_at(inputs, ("TRA_deg", "ALT_ft")).delta2
    torque_pct = ((20.0 + inputs[:, 0]) * delta)[:, None]
    layout = Layout(
        input_names=("TRA_deg", "ALT_ft"), output_names=("TRQ_pct",), driver="TRA_deg",
        exponents=("theta", "delta"),
    )  # fmt: skip
    left = [
        fit_steady_state([SteadySamples(inputs, torque_pct)], each)[1].rms["TRQ_pct"]
        for each in (layout, replace(layout, exponents=()))
    ]
    assert left[0] < 1.5 < 0.2 * left[1]
