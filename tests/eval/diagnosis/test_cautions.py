"""What a reader has to know is said in a sentence each, and nothing where all is well."""

import numpy as np
import pytest

from eval.diagnosis.diagnose import diagnose_pairs
from eval.diagnosis.document import Evidence, cautions, coarse_emulator, implausible
from eval.diagnosis.pairs import pair_logs, read_pairs
from eval.diagnosis.where import locate
from eval.diagnosis.words import sentences
from tests.eval.diagnosis.conftest import batch
from training.diagnosis.budget import Interval


def said(pairs):
    return cautions(pairs, batch(pairs))


def test_nothing_is_said_of_good_logs(pair):
    assert said([pair(seed) for seed in range(3)]) == []


def test_fewer_than_three_flights_are_said(pair):
    assert said([pair(0)]) == ["1 flight: the uncertainty is wider"]
    assert said([pair(0), pair(1)]) == ["2 flights: the uncertainty is wider"]


def test_a_channel_that_is_not_on_both_sides_is_said(fly, record, log_of):
    pairs = []
    for seed in range(3):
        sim = fly(seed)
        real = {**record(sim, seed), "FF_kgph": 100.0 + sim["N2_pct"]}
        del sim["EGT_C"]
        pairs.append(pair_logs(f"f{seed}", log_of(real), log_of(sim)))
    assert said(pairs) == [
        "EGT_C is recorded but not simulated: it is left out",
        "FF_kgph is recorded but not simulated: it is left out",
    ]


def test_a_channel_that_one_flight_lacks_is_said(tmp_path, fly, record, write):
    for seed in range(3):
        sim = fly(seed, 100.0)
        real = record(sim, seed)
        for channels in (sim, real):
            if seed == 1:
                del channels["EGT_C"], channels["NAI"]
        write(tmp_path / "real" / f"f{seed}.csv", real)
        write(tmp_path / "sim" / f"f{seed}.csv", sim)
    pairs = read_pairs(tmp_path / "real", tmp_path / "sim")
    assert tuple(pairs[0].sim) == ("N1_pct", "N2_pct")
    assert said(pairs) == [
        "EGT_C is missing in f1: it is left out",
        "NAI is missing in f1: it is left out",
    ]


def test_kelvin_on_one_side_is_suspected(fly, record, log_of):
    sim = fly(0)
    real = record(sim)
    sim["EGT_C"] = sim["EGT_C"] + 273.15
    words = said([pair_logs("f", log_of(real), log_of(sim))])
    assert words[1] == (
        "the simulated EGT_C looks like kelvin: it is -273.2 degC off the other throughout"
    )


def test_another_hundred_per_cent_is_suspected(fly, record, log_of):
    sim = fly(0)
    real = record(sim)
    real["N2_pct"] = 1.12 * real["N2_pct"]
    words = said([pair_logs("f", log_of(real), log_of(sim))])
    assert len(words) == 2
    assert words[1] == (
        "recorded N2_pct is +12 % of its level off the simulated one throughout: another engine, "
        "or another speed for 100 %?"
    )


@pytest.fixture
def evidence(make_data, make_budget, probe):
    """Build the evidence of a claimed effect, its emulator's error on EGT of a size."""

    def build(name, size, parameters=None):
        own = {"N1_pct": 0.01, "N2_pct": 0.01, "EGT_C": size}
        found = make_budget("effects", {name: parameters or {"tau_s": Interval(1.0, 0.9, 1.1)}})
        data = make_data(probe, flights=2)
        share = Interval(0.9, 0.8, 1.0)
        return Evidence(data, found, locate(data), data.flights.y, {}, share, {}, None, own)

    return build


SPOOL = {"factor": Interval(1.2, 1.1, 1.3)}
PLAY = {"width_deg": Interval(2.0, 1.0, 3.0)}
IDLE = {"meets": Interval(0.3, 0.2, 0.4), "idle_N2_pct": Interval(2.0, 1.0, 3.0)}
SOAK = {"tau_s": Interval(60.0, 50.0, 70.0), "loss": Interval(2.0, 1.0, 3.0)}
WARM = {"tau_s": Interval(60.0, 50.0, 70.0), "loss": Interval(0.0, 0.0, 1.0)}


@pytest.mark.parametrize(
    ("name", "sizes"), [("spool_lag", SPOOL), ("idle_schedule", IDLE), ("heat_soak", SOAK)]
)
def test_an_emulator_that_is_no_match_for_the_gap_is_said(name, sizes, evidence):
    words = coarse_emulator(evidence(name, 30.0, sizes), again=True)
    assert len(words) == 1
    assert words[0].startswith("the emulator's own error is more than half of the gap in EGT_C ")
    assert coarse_emulator(evidence(name, 1.0, sizes), again=True) == []


def test_it_is_not_said_of_effects_that_need_no_emulator(evidence):
    assert coarse_emulator(evidence("sensor_lag:EGT_C", 30.0), again=False) == []
    assert coarse_emulator(evidence("heat_soak", 30.0, WARM), again=False) == []
    assert coarse_emulator(evidence("throttle_backlash", 30.0, PLAY), again=True) == []
    assert coarse_emulator(evidence("throttle_backlash", 30.0, PLAY), again=False) != []


def test_unknown_samples_are_said(fly, record, log_of):
    sim = fly(0)
    real = record(sim)
    real["N1_pct"][:384] = np.nan
    words = said([pair_logs("f", log_of(real), log_of(sim))])
    assert words[1] == "3.3 % of the recorded samples are unknown"


def test_logs_in_another_unit_are_undetermined_with_that_as_the_reason(fly, record, log_of):
    word, pairs = "the recorded EGT_C looks like degF", []
    for seed in range(3):
        sim = fly(seed, rate_hz=4.0)
        real = record(sim, seed)
        real["EGT_C"] = 1.8 * real["EGT_C"] + 32.0
        pairs.append(pair_logs(f"f{seed}", log_of(real), log_of(sim)))
    document = diagnose_pairs(pairs).document
    assert document["verdict"]["kind"] == "unknown"
    assert document["verdict"]["effects"] == []
    assert document["verdict"]["reason"].startswith(word)
    assert sentences(document)[0].startswith(f"Undetermined: {word}")


@pytest.mark.parametrize(("channel", "off"), [("EGT_C", 60.0), ("N1_pct", 1.5), ("N2_pct", -1.0)])
def test_a_biased_sensor_is_in_no_other_unit(fly, record, log_of, channel, off):
    sim = fly(0)
    real = record(sim)
    real[channel] = real[channel] + off
    assert implausible(batch([pair_logs("f", log_of(real), log_of(sim))])) == []
