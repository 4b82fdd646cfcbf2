"""Code words of a recorder are found from the data, and sound channels have none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.cleaning.words import CodeWords, code_words
from data_prep.config import LogsConfig
from data_prep.prepare import prepare
from data_prep.reading import read_logs

BITS = {"N1": (10, 0.125), "N2": (10, 0.125), "EGT": (10, 1.0), "FF": (12, 2.0), "TRA": (9, 0.25)}


def engine(seed, seconds=1800, rate=4):
    """A lever moved every half minute or so, and lags behind it."""
    rng = np.random.default_rng(seed)
    lever = np.repeat(rng.uniform(5.0, 60.0, seconds // 30), 30 * rate)
    lever = np.convolve(lever, np.ones(4 * rate) / (4 * rate), "same")
    speed = np.empty(len(lever))
    speed[0] = lever[0]
    for k in range(1, len(lever)):
        speed[k] = speed[k - 1] + (lever[k] - speed[k - 1]) / (2.0 * rate)
    noise = rng.normal(0.0, 0.1, (4, len(lever)))
    return {
        "TRA": lever,
        "N1": 20.0 + 1.3 * speed + noise[0],
        "N2": 55.0 + 0.7 * speed + noise[1],
        "EGT": 350.0 + 7.0 * speed + 10.0 * noise[2],
        "FF": 300.0 + 55.0 * speed + 10.0 * noise[3],
    }


def words(values, name):
    bits, resolution = BITS[name]
    return np.clip(np.round(values / resolution), 0, 2**bits - 2) * resolution


def ones(name):
    bits, resolution = BITS[name]
    return (2**bits - 1) * resolution


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), period=st.integers(2, 64), length=st.integers(1, 2))
def test_words_of_all_ones_are_found_at_any_period_and_nothing_else(seed, period, length):
    period = max(period, 2 * length)
    for name, values in engine(seed, 600).items():
        sound = words(values, name)
        assert code_words(sound) == ()
        marked = (np.arange(len(sound)) + seed) % period < length
        (word,) = code_words(np.where(marked, ones(name), sound))
        assert word.why == f"all ones of {BITS[name][0]} bits"
        np.testing.assert_array_equal(word.rows(np.where(marked, ones(name), sound)), marked)


def pushes(stop):
    """A lever that is stepped to its stop and back."""
    ramp = words(np.linspace(5.0, 40.0, 400), "TRA")
    return np.concatenate([ramp, np.tile(np.repeat([40.0, stop], 80), 12), ramp[::-1]])


@pytest.mark.parametrize(
    "sound",
    [
        pushes(100.0),
        pushes(ones("TRA")),
        np.minimum(words(engine(5)["N2"], "N2"), np.median(engine(5)["N2"])),  # at full scale
        np.where(np.arange(4000) // 40 % 2, 63.75, 20.0),
    ],
)
def test_sound_channels_have_no_code_words(sound):
    assert code_words(sound) == ()


def test_a_constant_at_a_fixed_period_is_a_code_word_without_being_all_ones():
    sound = words(engine(3)["EGT"], "EGT")
    marked = np.arange(len(sound)) % 32 == 7
    (word,) = code_words(np.where(marked, 0.0, sound))
    assert word.why == "every 32 rows"
    np.testing.assert_array_equal(word.rows(np.where(marked, 0.0, sound)), marked)


def export(folder, seed, period):
    """The export of an airliner's recorder: frames of four words, each at its own place.

    Two rows below the header, `*` where a word is not sampled, all ones every `period` seconds.
    """
    flight, rate = engine(seed), 4
    time = np.arange(len(flight["N1"])) / rate
    place = {"TRA": 0, "N1": 1, "N2": 2, "EGT": 3, "FF": 0}
    head = "Time,Subframe,TLA 1,N1 Eng 1,N2 Eng 1,EGT 1,FF 1\n"
    types = "(sec),(),(deg),(% RPM),(%),(deg C),(kg/hr)\nNUMBER,NUMBER,DEG,%N(1),%N(2),DEGC,WF\n"
    cells = {
        name: np.where(time % period < 1.0, ones(name), words(values, name))
        for name, values in flight.items()
    }
    path = folder / f"export_{seed}.csv"
    with path.open("w", encoding="utf-8") as file:
        file.write(head + types)
        for k, t in enumerate(time):
            sampled = {name: k % rate == at for name, at in place.items()}
            row = [f"{cells[name][k]:.10g}" if sampled[name] else "*" for name in place]
            file.write(",".join([f"{t:.2f}", str(k // rate % 4 + 1), *row]) + "\n")
    return path, flight, place


COLUMNS = {
    "time_s": {"column": "Time"},
    "TRA_deg": {"column": "TLA 1"},
    "N1_pct": {"column": "N1 Eng 1", "unit": "%"},
    "N2_pct": {"column": "N2 Eng 1"},
    "EGT_C": {"column": "EGT 1"},
    "FF_kgph": {"column": "FF 1"},
}


@pytest.mark.parametrize("period", [8, 16])
def test_an_airliner_s_export_is_read_untouched_each_word_at_its_place(tmp_path, period):
    path, flight, place = export(tmp_path, 1, period)
    (log,) = read_logs(path, LogsConfig.parse({"columns": COLUMNS}))
    assert log.dt_s == pytest.approx(0.25)
    names = dict(zip(("TRA", "N1", "N2", "EGT", "FF"), list(COLUMNS)[1:], strict=True))
    counted = {(one.channel, one.reason): one.samples for one in log.audit.entries}
    time = np.arange(len(flight["N1"]))
    for name, channel in names.items():
        bits, _ = BITS[name]
        reason = f"code word {ones(name):g}: all ones of {bits} bits"
        frames = len(time) // 4
        assert counted[channel, reason] == -(-frames // period)
        assert counted[channel, "no value: *"] == len(time) - frames
        own = (time % 4 == place[name]) & (time // 4 % period > 0)
        at = np.round(log.time_s * 4).astype(int)
        exact = own[at] & np.isfinite(log[channel])
        assert exact.sum() > 0.99 * own.sum()
        np.testing.assert_array_equal(log[channel][exact], words(flight[name], name)[at][exact])
    assert counted["*", "row of types or codes below the header"] == 1


@pytest.mark.parametrize("size", [1, 7, 400])
def test_words_of_a_growing_file_are_masked_from_where_they_can_be_known(size):
    sound = words(engine(3, 600)["N1"], "N1")
    marked = np.arange(len(sound)) % 32 == 5
    rows = np.where(marked, ones("N1"), sound)
    reader = CodeWords()
    masked = np.concatenate(
        [
            np.any([rows for _, rows in found] or [np.zeros(len(part), np.bool_)], axis=0)
            for start in range(0, len(rows), size)
            for part in [rows[start : start + size]]
            for found in [reader.masks(part)]
        ]
    )
    known = np.flatnonzero(masked)[0]
    assert known < 1024
    np.testing.assert_array_equal(masked[known:], marked[known:])


def test_a_channel_of_which_half_is_code_words_gets_a_warning(tmp_path):
    rows = engine(4, 300)
    half = np.where(np.arange(len(rows["N1"])) % 2 == 0, ones("N1"), words(rows["N1"], "N1"))
    table = np.column_stack([np.arange(len(half)) / 4.0, words(rows["TRA"], "TRA"), half])
    path = tmp_path / "log.csv"
    header = "time_s,TRA_deg,N1_pct"
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header=header, comments="")
    (one,) = prepare(read_logs(path))
    (found,) = [each.text for each in one.warnings if each.kind == "coded"]
    assert found == f"half of the samples or more are code words: N1_pct ({len(half) // 2})"
