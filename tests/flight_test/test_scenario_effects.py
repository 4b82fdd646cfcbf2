"""Effects on a command line and in a file: what is understood, and every message of refusal."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.effects.library import LIBRARY, RARE
from narxcal.flight_test.scenario import PARAMETERS, WINDOWED, FlownEffect, parse_effects
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
    text = f"{wanted.name}:" + ",".join(f"{name}={value}" for name, value in sizes.items())
    assert parse_effects([text]) == (wanted,)
    assert wanted.on_sensor == (effect in ON_SENSORS)


LAG = FlownEffect(id="sensor_lag", channel="EGT_C", parameters={"tau_s": 1.5})
METER = FlownEffect(
    id="flowmeter_dynamics",
    channel="FF_kgph",
    parameters={"tau_s": 0.4, "reference_kgph": 500.0},
)
BIAS = FlownEffect(
    id="sensor_bias",
    channel="N1_pct",
    parameters={"offset": -0.5},
    windows_s=((10.0, 60.0), (100.0, 130.5)),
    flights=(2, 3),
    engines=("left",),
)
TEXTS = (
    "sensor_lag@EGT_C:tau_s=1.5",
    "flowmeter_dynamics@FF_kgph:tau_s=0.4,reference_kgph=500",
    "sensor_bias@N1_pct:offset=-0.5,window=10-60,window=100-130.5,flight=2,flight=3,engine=left",
)


@pytest.mark.parametrize(
    "words",
    [
        TEXTS,
        [",".join(TEXTS)],
        [" ".join(TEXTS)],
        [", ".join(TEXTS)],
        [TEXTS[0], f"{TEXTS[1]},", TEXTS[2].replace(",", ":")],
        [text.replace(",", " ") for text in TEXTS],
    ],
)
def test_commas_blanks_and_words_are_alike(words):
    assert parse_effects(words) == (LAG, METER, BIAS)


@given(value=st.floats(0.0, 20.0))
def test_sizes_are_read_to_the_last_digit(value):
    (effect,) = parse_effects([f"sensor_lag@EGT_C:tau_s={value!r}"])
    assert effect.parameters["tau_s"] == value


@pytest.mark.parametrize("words", [["none"], [], [""], [" , "]])
def test_no_effects_can_be_asked_for(words):
    assert parse_effects(words) == ()


def test_an_effect_acts_where_and_when_it_was_said_to():
    assert BIAS.acts(2, "left")
    assert not BIAS.acts(2, "right")
    assert not BIAS.acts(1, "left")
    assert LAG.acts(7, "right")
    fault = BIAS.fault()
    assert (fault.id, fault.channel, fault.windows_s) == ("sensor_bias", "N1_pct", BIAS.windows_s)
    assert fault["offset"] == -0.5


def test_one_effect_on_either_engine_is_not_the_same_effect_twice():
    left, right = (f"sensor_lag@EGT_C:tau_s={t},engine={e}" for t, e in ((1, "left"), (2, "right")))
    assert len(parse_effects([left, right])) == 2
    assert len(parse_effects([f"{TEXTS[0]},flight=1", f"{TEXTS[0]},flight=2"])) == 2


WRITE = "Write ID[@CHANNEL]:NAME=VALUE[,NAME=VALUE...]"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("spool_lgg:factor=2", "unknown effect 'spool_lgg'. Did you mean 'spool_lag'?"),
        ("zzz:a=1", f"unknown effect 'zzz'. Known are {', '.join(sorted(PARAMETERS))}"),
        (
            "sensor_lag@EGT_C:tau=1",
            "effect 'sensor_lag' has no parameter 'tau'. Did you mean 'tau_s'?",
        ),
        (
            "sensor_lag@EGT_C:offset=1",
            "effect 'sensor_lag' has no parameter 'offset'. Known are tau_s",
        ),
        (
            "sensor_lag:tau_s=1",
            (
                "effect 'sensor_lag' acts on one channel, and none is given. "
                "Write, for example, sensor_lag@EGT_C"
            ),
        ),
        (
            "flowmeter_dynamics:tau_s=1",
            (
                "effect 'flowmeter_dynamics' acts on one channel, and none is given. "
                "Write, for example, flowmeter_dynamics@FF_kgph"
            ),
        ),
        ("sensor_lag@ETG_C:tau_s=1", "unknown channel 'ETG_C'. Did you mean 'EGT_C'?"),
        (
            "flowmeter_dynamics@N1_pct:tau_s=1",
            "effect 'flowmeter_dynamics' cannot act on N1_pct. It can act on FF_kgph",
        ),
        (
            "spool_lag@N1_pct:factor=1.2",
            (
                "effect 'spool_lag' acts on the engine and has no channel, found 'N1_pct'. "
                "Write spool_lag alone"
            ),
        ),
        (
            "sensor_lag@EGT_C:tau_s=99",
            "effect 'sensor_lag': tau_s has to lie in 0 .. 20 s, found 99",
        ),
        (
            "sensor_lag@EGT_C:tau_s=-1",
            "effect 'sensor_lag': tau_s has to lie in 0 .. 20 s, found -1",
        ),
        ("sensor_lag@EGT_C", "effect 'sensor_lag' has no size. Give tau_s"),
        (
            "flowmeter_dynamics@FF_kgph",
            "effect 'flowmeter_dynamics' has no size. Give tau_s or reference_kgph",
        ),
        (
            "sensor_lag@EGT_C:tau_s=much",
            "effect 'sensor_lag': tau_s has to be a number, found 'much'",
        ),
        (
            "sensor_lag@EGT_C:tau_s=nan",
            "effect 'sensor_lag': tau_s has to be a number, found 'nan'",
        ),
        (
            "sensor_lag@EGT_C:tau_s=1,window=0-9",
            (
                "effect 'sensor_lag' acts all the time and has no windows. "
                f"Windows are for {', '.join(WINDOWED)}"
            ),
        ),
        (
            "sensor_bias@EGT_C:offset=1,window=9-3",
            (
                "effect 'sensor_bias': a window has to start at 0 s or later and before its end, "
                "found 9-3"
            ),
        ),
        (
            "sensor_bias@EGT_C:offset=1,window=9",
            "effect 'sensor_bias': window has to be START-END in s, found '9'",
        ),
        (
            "sensor_bias@EGT_C:offset=1,window=a-9",
            "effect 'sensor_bias': window has to be a number, found 'a'",
        ),
        (
            "sensor_bias@EGT_C:offset=1,flight=0",
            "effect 'sensor_bias': flights are counted from 1, found 0",
        ),
        (
            "sensor_bias@EGT_C:offset=1,flight=1.5",
            "effect 'sensor_bias': flight has to be a whole number, found '1.5'",
        ),
        (
            "sensor_bias@EGT_C:offset=1,engine=middle",
            "key 'engines.0': Input should be 'left' or 'right', found 'middle'",
        ),
        ("@EGT_C:tau_s=1", f"cannot read the effect '@EGT_C'. {WRITE}"),
        ("sensor_lag@:tau_s=1", f"cannot read the effect 'sensor_lag@'. {WRITE}"),
        ("tau_s=1", f"'tau_s=1' belongs to no effect. {WRITE}"),
        ("sensor_lag@EGT_C:", f"effect 'sensor_lag': cannot read ''. {WRITE}"),
        ("sensor_lag@EGT_C:tau_s", f"effect 'sensor_lag': cannot read 'tau_s'. {WRITE}"),
        ("sensor_lag@EGT_C:tau_s=", f"effect 'sensor_lag': cannot read 'tau_s='. {WRITE}"),
        ("sensor_lag@EGT_C:=1", f"effect 'sensor_lag': cannot read '=1'. {WRITE}"),
        (
            "sensor_lag@EGT_C:tau_s=1,tau_s=2",
            "effect 'sensor_lag': tau_s is given twice",
        ),
        (
            "sensor_lag@EGT_C:tau_s=1,sensor_lag@EGT_C:tau_s=2",
            "effect 'sensor_lag@EGT_C' is given twice. Give its parameters at one place",
        ),
        ("none,sensor_lag@EGT_C:tau_s=1", "unknown effect 'none'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(text, message):
    with pytest.raises(ConfigError) as error:
        parse_effects([text])
    assert str(error.value).startswith(message)
    assert str(error.value) == message or text.startswith("none")


@given(st.text("abc_@:=,- 019.", max_size=20))
def test_no_text_ends_in_anything_but_effects_or_a_sentence(text):
    try:
        found = parse_effects([text])
    except ConfigError:
        return
    assert all(isinstance(effect, FlownEffect) for effect in found)
