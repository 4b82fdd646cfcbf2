"""A step of one channel is no drift, and a drift is no step."""

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import DT, NOISE
from training.gap.diagnosis import diagnose
from training.gap.fitting import Problem, fit
from training.gap.foils import is_a_step, is_no_heat, is_no_metal
from training.gap.quadratic import misfit
from training.gap.work import Simulators


def with_steps(real, at):
    """EGT that reads 12 degC more from a share `at` of each flight on."""
    shifted = real.copy()
    for f, share in enumerate(at):
        shifted[f, round(share * shifted.shape[1]) :, 2] += 12.0
    return shifted


def drift_in(flights, engine, real):
    measure = misfit(flights, real, NOISE)
    return fit([effect("sensor_drift:EGT_C")], Problem(flights, engine, measure)), measure


@pytest.mark.parametrize("at", [(0.5,) * 5, (0.2, 0.4, 0.5, 0.6, 0.8)])
def test_a_step_in_mid_flight_is_a_step(at, flights, engine, recorded):
    assert is_a_step(*drift_in(flights, engine, with_steps(recorded({}), at)))


@pytest.mark.parametrize("rate_per_h", [100.0, -400.0])
def test_a_drift_is_not(rate_per_h, flights, engine, recorded):
    real = recorded({"sensor_drift:EGT_C": [rate_per_h]})
    assert not is_a_step(*drift_in(flights, engine, real))


def test_what_holds_no_drift_is_not_asked(flights, engine, recorded):
    measure = misfit(flights, with_steps(recorded({}), (0.5,) * 5), NOISE)
    lag = fit([effect("sensor_lag:EGT_C")], Problem(flights, engine, measure))
    assert not is_a_step(lag, measure)


def test_a_drift_beside_a_lag_is_still_seen(flights, engine, recorded):
    real = recorded({"sensor_lag:N2_pct": [0.8, 0.5]})
    drifting = real.copy()
    drifting[..., 2] += 0.06 * DT * np.arange(real.shape[1])
    effects = [effect("sensor_lag:N2_pct"), effect("sensor_drift:EGT_C")]
    for recording, expected in ((drifting, False), (with_steps(real, (0.5,) * 5), True)):
        measure = misfit(flights, recording, NOISE)
        both = fit(effects, Problem(flights, engine, measure))
        assert is_a_step(both, measure) is expected


def test_what_steps_would_gain_anyway_is_no_evidence_for_them(flights, engine, recorded):
    """A channel that also swings slowly has a best step somewhere, drift or not."""
    swing = 3.0 * np.sin(np.linspace(0.0, 5.0, 800))
    for rate_per_h, expected in ((150.0, False), (0.0, True)):
        real = recorded({"sensor_drift:EGT_C": [rate_per_h]})
        real[..., 2] += swing if expected else swing * np.array([1, -1, 1, -1, 1])[:, None]
        tried, measure = drift_in(
            flights, engine, with_steps(real, (0.5,) * 5) if expected else real
        )
        assert is_a_step(tried, measure) is expected


def test_the_diagnosis_names_no_drift_where_a_channel_jumped(flights, engine, recorded):
    real = with_steps(recorded({}), (0.5,) * 5)
    found = diagnose(flights, (real, NOISE), Simulators(engine))
    assert "sensor_drift:EGT_C" not in found.effects


@pytest.mark.parametrize(
    ("shares", "foil"), [([-0.02, 0.0], True), ([0.0, -0.1], False), ([-0.002, -0.1], False)]
)
def test_heat_that_no_temperature_shows_is_none(shares, foil, flights, engine, recorded):
    """Shares of N2 and of the temperature."""
    real = recorded({"heat_soak": [60.0, 0.0, *shares, 0.0]})
    measure = misfit(flights, real, NOISE)
    soak = fit([effect("heat_soak")], Problem(flights, engine, measure))
    outputs = flights.signals.outputs
    assert is_no_heat(soak, measure, outputs) is foil
    assert not is_no_heat(soak, measure, ("N1_pct", "N2_pct", "FF_kgph"))
    lag = fit([effect("sensor_lag:EGT_C")], Problem(flights, engine, measure))
    assert not is_no_heat(lag, measure, outputs)
    found = diagnose(flights, (real, NOISE), Simulators(engine))
    assert ("heat_soak" in found.effects) is not foil
    assert ("but no temperature shows the heat" in found.reason) is foil


@pytest.mark.parametrize(
    ("size", "foil"), [((2.0, -0.3), True), ((60.0, -0.2), False), ((4000.0, -2.0), True)]
)
def test_what_fades_faster_or_slower_than_metal_is_no_heat(size, foil, flights, engine, recorded):
    tau_s, share = size
    real = recorded({"heat_soak": [tau_s, 0.0, 0.0, share, 0.0]})
    measure = misfit(flights, real, NOISE)
    soak = fit([effect("heat_soak")], Problem(flights, engine, measure))
    assert is_no_metal(soak) is foil, soak.theta
    found = diagnose(flights, (real, NOISE), Simulators(engine))
    assert ("heat_soak" in found.effects) is not foil, found.reason
