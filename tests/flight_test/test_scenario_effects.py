"""Effects of a scenario: what is understood, and every message of refusal."""

import pytest

from narxcal.effects.library import LIBRARY, RARE
from narxcal.flight_test.scenario import PARAMETERS, WINDOWED, FlownEffect, check_once
from narxcal.flight_test.sensors import PARAMETERS as ON_SENSORS
from narxcal.flight_test.sensors import channels_of
from narxcal.support.errors import ConfigError


def test_the_whole_library_can_be_flown_but_for_scales_that_sensor_presets_have():
    assert set(PARAMETERS) == set(LIBRARY) - {kind.id for kind in RARE}


@pytest.mark.parametrize("effect", sorted(PARAMETERS))
def test_every_size_that_the_library_fits_can_be_flown(effect):
    for fitted in LIBRARY[effect].fixed:
        flown = PARAMETERS[effect].get(fitted.name)
        if flown is not None:
            assert flown.low <= fitted.low <= fitted.high <= flown.high
            assert (flown.unit, flown.neutral) == (fitted.unit, fitted.neutral)


@pytest.mark.parametrize("effect", sorted(PARAMETERS))
def test_every_effect_reads_back_as_it_was_written(effect):
    channel = channels_of(effect)[0] if effect in ON_SENSORS else None
    sizes = {
        name: round(low + 0.25 * (high - low), 6)
        for name, (_, low, high, _) in PARAMETERS[effect].items()
    }
    wanted = FlownEffect(id=effect, channel=channel, parameters=sizes)
    assert FlownEffect.parse(wanted.model_dump(exclude_unset=True)) == wanted
    assert wanted.on_sensor == (effect in ON_SENSORS)


LAG = FlownEffect(id="sensor_lag", channel="EGT_C", parameters={"tau_s": 1.5})
BIAS = FlownEffect(
    id="sensor_bias",
    channel="N1_pct",
    parameters={"offset": -0.5},
    windows_s=((10.0, 60.0), (100.0, 130.5)),
    flights=(2, 3),
    engines=("left",),
)


def test_an_effect_acts_where_and_when_it_was_said_to():
    assert BIAS.acts(2, "left")
    assert not BIAS.acts(2, "right")
    assert not BIAS.acts(1, "left")
    assert LAG.acts(7, "right")
    fault = BIAS.fault()
    assert (fault.id, fault.channel, fault.windows_s) == ("sensor_bias", "N1_pct", BIAS.windows_s)
    assert fault["offset"] == -0.5


LAGS = {"id": "sensor_lag", "channel": "EGT_C", "parameters": {"tau_s": 1.0}}
OFF = {"id": "sensor_bias", "channel": "EGT_C", "parameters": {"offset": 1.0}}
METER = {"id": "flowmeter_dynamics", "parameters": {"tau_s": 1.0}}


@pytest.mark.parametrize(
    ("first", "second", "twice"),
    [
        ({"engines": ["left"]}, {"engines": ["right"]}, False),
        ({"flights": [1]}, {"flights": [2]}, False),
        ({"flights": [1, 2]}, {"flights": [2]}, True),
        ({}, {"engines": ["right"]}, True),
    ],
)
def test_one_effect_on_either_engine_is_not_the_same_effect_twice(first, second, twice):
    both = [FlownEffect.parse(LAGS | each) for each in (first, second)]
    if not twice:
        check_once(both)
        return
    message = "effect 'sensor_lag@EGT_C' is given twice. Give its parameters at one place"
    with pytest.raises(ConfigError, match=message):
        check_once(both)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (LAGS | {"id": "spool_lgg"}, "unknown effect 'spool_lgg'. Did you mean 'spool_lag'?"),
        (LAGS | {"id": "zzz"}, f"unknown effect 'zzz'. Known are {', '.join(sorted(PARAMETERS))}"),
        (
            LAGS | {"parameters": {"tau": 1.0}},
            "effect 'sensor_lag' has no parameter 'tau'. Did you mean 'tau_s'?",
        ),
        (
            LAGS | {"parameters": {"offset": 1.0}},
            "effect 'sensor_lag' has no parameter 'offset'. Known are tau_s",
        ),
        (
            LAGS | {"channel": None},
            (
                "effect 'sensor_lag' acts on one channel, and none is given. "
                "Give one, for example channel = 'EGT_C'"
            ),
        ),
        (
            METER,
            (
                "effect 'flowmeter_dynamics' acts on one channel, and none is given. "
                "Give one, for example channel = 'FF_kgph'"
            ),
        ),
        (LAGS | {"channel": "ETG_C"}, "unknown channel 'ETG_C'. Did you mean 'EGT_C'?"),
        (
            METER | {"channel": "N1_pct"},
            "effect 'flowmeter_dynamics' cannot act on N1_pct. It can act on FF_kgph",
        ),
        (
            {"id": "spool_lag", "channel": "N1_pct", "parameters": {"factor": 1.2}},
            (
                "effect 'spool_lag' acts on the engine and has no channel, found 'N1_pct'. "
                "Leave the channel out"
            ),
        ),
        (
            LAGS | {"parameters": {"tau_s": 99.0}},
            "effect 'sensor_lag': tau_s has to lie in 0 .. 20 s, found 99",
        ),
        (
            LAGS | {"parameters": {"tau_s": -1.0}},
            "effect 'sensor_lag': tau_s has to lie in 0 .. 20 s, found -1",
        ),
        (LAGS | {"parameters": {}}, "effect 'sensor_lag' has no size. Give tau_s"),
        (
            METER | {"channel": "FF_kgph", "parameters": {}},
            "effect 'flowmeter_dynamics' has no size. Give tau_s or reference_kgph",
        ),
        (
            LAGS | {"windows_s": [[0.0, 9.0]]},
            (
                "effect 'sensor_lag' acts all the time and has no windows. "
                f"Windows are for {', '.join(WINDOWED)}"
            ),
        ),
        (
            OFF | {"windows_s": [[9.0, 3.0]]},
            (
                "effect 'sensor_bias': a window has to start at 0 s or later and before its end, "
                "found 9-3"
            ),
        ),
        (OFF | {"flights": [0]}, "effect 'sensor_bias': flights are counted from 1, found 0"),
        (
            OFF | {"engines": ["middle"]},
            "key 'engines.0': Input should be 'left' or 'right', found 'middle'",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(table, message):
    with pytest.raises(ConfigError) as error:
        FlownEffect.parse(table)
    assert str(error.value) == message
