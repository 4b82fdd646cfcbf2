"""The whole diagnosis on made-up flights, with the search for effects replaced by its answer."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eval.gap import diagnose as module
from eval.gap.diagnose import Request, diagnose_folders, diagnose_pairs
from eval.gap.expected import expected, seen, unseen
from eval.gap.pairs import pair_logs
from narxcal.support.errors import ConfigError, DataError
from training.budget.result import Interval

NAME = "sensor_lag:EGT_C"


class NoEmulator:
    """Stands in for the emulator, which effects on sensors do not need."""

    calibration = None

    def errors(self, flights):
        return np.zeros(len(flights.signals.outputs))


@pytest.fixture
def answer(monkeypatch, make_finding, make_model):
    """Makes the search find this."""

    def set_to(kind="effects", effects=(NAME,)):
        found = make_finding(kind, effects, (make_model(NAME),))
        monkeypatch.setattr(module, "fit_emulators", lambda _flights: (NoEmulator(),))
        monkeypatch.setattr(module, "diagnose", lambda *_args, **_more: found)

    set_to()
    return set_to


def test_found_effects_are_checked_on_flights_that_took_no_part(answer, pair, probe):
    pairs = [pair(seed, probe) for seed in range(5)]
    steps = []
    found = diagnose_pairs(pairs[:3], pairs[3:], lambda *step: steps.append(step[0]))
    shrink = found.document["shrink"]
    assert shrink["realised"] > 0.98
    assert shrink["channels"]["EGT_C"]["after"] < 0.1 * shrink["channels"]["EGT_C"]["before"]
    assert shrink["times"]["EGT_C"]["Tt_after_s"] < 0.2 * shrink["times"]["EGT_C"]["Tt_before_s"]
    assert found.document["quality"]["held_out"] == ["flight_3", "flight_4"]
    assert steps == ["emulator", "windows of an unlogged load", "where"]
    json.dumps(found.document)


def test_the_prediction_is_about_the_flights_that_are_held_out(answer, pair, probe):
    pairs = [pair(seed, probe) for seed in range(5)]
    told, alone = (diagnose_pairs(pairs[:3], held).evidence for held in (pairs[3:], ()))
    here, held = seen(told.data, told.after, None), told.held_out
    assert told.predicted == expected(here, unseen(held.data, held.after))
    assert alone.predicted == expected(here)


def test_a_wrong_claim_does_not_shrink_the_gap(answer, pair):
    pairs = [pair(seed) for seed in range(4)]
    assert diagnose_pairs(pairs[:3], pairs[3:]).document["shrink"]["realised"] < 0.0


def test_nothing_claimed_changes_nothing(answer, pair, probe):
    answer("unknown", ())
    pairs = [pair(seed, probe) for seed in range(4)]
    found = diagnose_pairs(pairs[:3], pairs[3:])
    assert found.document["shrink"]["realised"] == 0.0
    assert found.document["where"][0]["channel"] == "EGT_C"
    np.testing.assert_array_equal(found.evidence.after, found.evidence.data.flights.y)


def test_an_offset_that_is_the_gap_is_where_the_gap_is(
    answer, pair, make_finding, make_model, monkeypatch
):
    pairs = [pair(seed, lambda sim: {"N1_pct": sim["N1_pct"] + 0.4}) for seed in range(3)]
    tried = make_model(NAME, gain=0.1), make_model("sensor_bias:N1_pct", gain=0.97)
    shares = {}
    for gain in (0.97, 0.5):
        models = tried[0], replace(tried[1], gain=gain)
        found = make_finding("none", (), models)
        monkeypatch.setattr(module, "diagnose", lambda *_args, found=found, **_more: found)
        rows = diagnose_pairs(pairs).document["where"]
        shares[gain] = sum(row["share"] for row in rows if row["channel"] == "N1_pct")
    assert shares[0.97] > 0.95
    assert shares[0.5] < 0.5


def test_one_short_flight_is_no_evidence(answer, pair, probe):
    found = diagnose_pairs([pair(0, probe)]).document
    assert found["verdict"]["kind"] == "unknown"
    assert "one flight is no evidence" in found["verdict"]["reason"]
    assert found["verdict"]["reason"].endswith(f"the best candidate is {NAME}")
    assert found["quality"]["warnings"] == ["1 flight: the uncertainty is wider"]


def test_parts_of_long_flights_stand_for_flights_and_it_is_said(answer, pair, probe):
    found = diagnose_pairs([pair(0, probe, duration_s=900.0, rate_hz=8.0)]).document
    assert found["verdict"]["kind"] == "effects"
    assert found["quality"]["parts"] == ["flight_0#1", "flight_0#2", "flight_0#3"]
    assert "3 parts of them stand for flights" in found["quality"]["warnings"][0]


def test_too_little_excitation_is_refused_before_any_work(answer, pair):
    with pytest.raises(
        DataError, match="too little excitation: 1 push and 0 pulls of TRA_deg in 1 flight"
    ):
        diagnose_pairs([pair(0, duration_s=30.0)])


def test_unknown_and_cut_samples_are_warned_of(answer, fly, record, log_of, probe):
    pairs = []
    for seed in range(3):
        sim = fly(seed)
        real = record(sim, seed, **probe(sim))
        real["N1_pct"][:300] = np.nan
        real = {name: values[:-5] for name, values in real.items()}
        pairs.append(pair_logs(f"f{seed}", log_of(real), log_of(sim)))
    quality = diagnose_pairs(pairs).document["quality"]
    assert quality["warnings"][0].endswith("% of the recorded samples are unknown")
    assert quality["warnings"][1].startswith("15 samples at the ends of flights")
    assert quality["changed"]["f1"]["N1_pct unknown"] == 300


def test_thrust_is_compared(answer, fly, record, log_of):
    sim = fly(0)
    sim["FN_kN"] = 0.1 * sim["N1_pct"]
    real = {**record(sim), "FN_kN": sim["FN_kN"] + 2.0}
    found = diagnose_pairs([pair_logs("f", log_of(real), log_of(sim))])
    assert found.document["quality"]["compared"] == {"FN_kN": pytest.approx(2.0)}


def test_held_out_flights_that_lack_a_channel_are_refused(answer, pair, fly, record, log_of):
    sim = fly(5)
    del sim["N2_pct"]
    held = pair_logs("f", log_of(record(sim)), log_of(sim))
    with pytest.raises(DataError, match="channel N2_pct: the held-out flights lack it"):
        diagnose_pairs([pair(seed) for seed in range(3)], [held])


@pytest.fixture
def folders(tmp_path, fly, record, probe, write):
    for seed in range(3):
        sim = fly(seed)
        write(tmp_path / "real" / f"{seed}.csv", record(sim, seed, **probe(sim)))
        write(tmp_path / "sim" / f"{seed}.csv", sim)
    return tmp_path / "real", str(tmp_path / "sim")


def test_folders_and_simulators_of_any_kind(answer, folders):
    real, sim = folders
    found = diagnose_folders(Request(real, sim)).document
    assert found["quality"]["simulator"] == "logs"
    assert found["quality"]["rate_hz"] == pytest.approx(16.0)
    assert found["quality"]["worked_at_hz"] == pytest.approx(8.0)
    request = Request(real, sim, held_real=real)
    with pytest.raises(DataError, match=r"need their simulated logs\. Name them by --heldout-sim"):
        diagnose_folders(request)
    with pytest.raises(ConfigError, match="is no folder of logs"):
        diagnose_folders(Request(real, "nothing"))


def test_logs_that_are_the_same_have_no_gap(fly, log_of):
    sims = [log_of(fly(seed, 60.0, rate_hz=8.0)) for seed in range(3)]
    found = diagnose_pairs([pair_logs(f"f{k}", sim, sim) for k, sim in enumerate(sims)]).document
    assert found["verdict"]["kind"] == "none"
    assert found["verdict"]["reason"] == "recorded and simulated logs are the same"
    assert found["effects"] == []
    assert found["quality"]["gap_share"] == 0.0


@pytest.fixture
def misread(fly, record, log_of):
    """Flights of a part of the lever's range, which the control reads 4 deg too high."""

    def build(part):
        every = [[fly(k, lever_of=(part, bias)) for bias in (0.0, 4.0)] for k in range(3)]
        return [
            pair_logs(f"f{k}", log_of(record(real, k)), log_of(sim))
            for k, (sim, real) in enumerate(every)
        ]

    return build


@pytest.mark.slow
def test_what_an_effect_does_on_held_out_flights_the_simulators_own_logs_say(
    misread, monkeypatch, make_finding, make_model
):
    """A lever that is read wrong, found at low power, on flights at full power."""
    size = {"throttle_bias": {"bias_deg": Interval(4.0, 3.9, 4.1)}}
    model = make_model("throttle_bias", parameters=size)
    finding = make_finding("effects", ("throttle_bias",), (model,))
    monkeypatch.setattr(module, "diagnose", lambda *_args, **_more: finding)
    pairs, held, steps = misread(0.5), misread(1.0), []
    found = diagnose_pairs(pairs, held, lambda *step: steps.append(step[0])).document
    assert found["shrink"]["realised"] > 0.85
    assert found["emulator"]["rmse_heldout"].keys() == found["emulator"]["rmse"].keys()
    assert found["emulator"]["rmse_heldout"]["EGT_C"] < 8.0
    assert steps[-2:] == ["emulator of the held-out flights too", "where"]
    monkeypatch.setattr(module, "widened", lambda emulator, _flights: emulator)
    assert diagnose_pairs(pairs, held).document["shrink"]["realised"] < 0.6
