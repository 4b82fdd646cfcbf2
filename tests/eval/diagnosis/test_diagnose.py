"""The whole diagnosis on made-up flights, with the weighing of effects replaced by its answer."""

import json
import re

import numpy as np
import pytest

from eval.diagnosis import diagnose as module
from eval.diagnosis import page, pictures
from eval.diagnosis.diagnose import Request, diagnose_folders, diagnose_pairs
from eval.diagnosis.expected import expected, seen, unseen
from eval.diagnosis.pairs import pair_logs
from narxcal.support.errors import ConfigError, DataError
from tests.eval.diagnosis.conftest import NAME, NoEmulator, lagged, weighed
from training.diagnosis.budget import Interval


def test_found_effects_are_checked_on_flights_that_took_no_part(answer, pair, probe):
    pairs = [pair(seed, probe) for seed in range(5)]
    steps = []
    found = diagnose_pairs(pairs[:3], pairs[3:], progress=lambda *step: steps.append(step[2]))
    shrink = found.document["shrink"]
    assert shrink["realised"] > 0.98
    assert shrink["channels"]["EGT_C"]["after"] < 0.1 * shrink["channels"]["EGT_C"]["before"]
    assert shrink["times"]["EGT_C"]["Tt_after_s"] < 0.2 * shrink["times"]["EGT_C"]["Tt_before_s"]
    assert found.document["quality"]["held_out"] == ["flight_3", "flight_4"]
    assert steps == ["emulator", "effects", "where, and how far the gap shrinks"]
    json.dumps(found.document)


def test_the_prediction_is_about_the_flights_that_are_held_out(answer, pair, probe):
    pairs = [pair(seed, probe) for seed in range(5)]
    both, alone = (diagnose_pairs(pairs[:3], held).evidence for held in (pairs[3:], ()))
    here, held = seen(both.data, both.after, None), both.held_out
    assert both.predicted == expected(here, unseen(held.data, held.after))
    assert alone.predicted == expected(here)


@pytest.mark.parametrize("tau_s", [20.0, 1e-9])
def test_a_claim_that_does_not_make_the_gap_smaller_is_no_answer(tau_s, answer, pair, probe):
    answer("effects", {NAME: {"tau_s": Interval(tau_s, 0.9 * tau_s, 1.1 * tau_s)}})
    pairs = [pair(seed, probe) for seed in range(4)]
    found = diagnose_pairs(pairs[:3], pairs[3:])
    assert found.document["verdict"]["kind"] == "unknown"
    reason = (
        r"the best candidate is lag of the EGT sensor .*, which takes -?\d+ % to -?\d+ % off what"
    )
    assert re.match(reason, found.document["verdict"]["reason"])
    assert found.document["shrink"]["realised"] == 0.0
    np.testing.assert_array_equal(found.evidence.after, found.evidence.data.flights.y)


def test_nothing_claimed_changes_nothing(answer, pair, probe):
    answer("unknown", {})
    pairs = [pair(seed, probe) for seed in range(4)]
    found = diagnose_pairs(pairs[:3], pairs[3:])
    assert found.document["shrink"]["realised"] == 0.0
    assert found.document["where"][0]["channel"] == "EGT_C"
    np.testing.assert_array_equal(found.evidence.after, found.evidence.data.flights.y)


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
    assert found["quality"]["worked_at_hz"] == pytest.approx(4.0)
    request = Request(real, sim, held_real=real)
    with pytest.raises(DataError, match=r"need their simulated logs\. Name them by --heldout-sim"):
        diagnose_folders(request)
    with pytest.raises(ConfigError, match="is no folder of logs"):
        diagnose_folders(Request(real, "nothing"))


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
    misread, monkeypatch, make_budget
):
    """A lever that is read wrong, found at low power, on flights at full power."""
    size = {"throttle_bias": {"bias_deg": Interval(4.0, 3.9, 4.1)}}
    budget = make_budget("effects", size)
    monkeypatch.setattr(module, "weigh", weighed)
    monkeypatch.setattr(module, "concluded", lambda *_args: budget)
    pairs, held = misread(0.5), misread(1.0)
    found = diagnose_pairs(pairs, held).document
    assert found["shrink"]["realised"] > 0.85
    assert found["emulator"]["rmse_heldout"].keys() == found["emulator"]["rmse"].keys()
    assert found["emulator"]["rmse_heldout"]["EGT_C"] < 8.0
    monkeypatch.setattr(module, "widened", lambda emulator, _flights: emulator)
    assert diagnose_pairs(pairs, held).document["shrink"]["realised"] < 0.6


def test_an_emulator_that_errs_more_than_the_gap_is_a_warning(answer, pair, probe, monkeypatch):
    class Coarse(NoEmulator):
        def errors(self, flights):
            return np.full(len(flights.signals.outputs), 30.0)

        def run(self, flights, told, pace=None, _shift=None):
            y = flights.y[np.arange(len(told)) % len(flights.y)].copy()
            if pace is not None and pace.fan_up[0] < 1.0:  # what the probe does
                y[..., 2] = [lagged(row, 1.0, flights.signals.dt_s) for row in y[..., 2]]
            return y

    answer("effects", {"spool_lag": {"factor": Interval(1.2, 1.1, 1.3)}})
    monkeypatch.setattr(module, "fit_emulators", lambda _flights: (Coarse(),))
    pairs = [pair(seed, probe) for seed in range(3)]
    (text,) = diagnose_pairs(pairs).document["quality"]["warnings"]
    assert text.startswith("the emulator's own error is more than half of the gap in ")
    assert text.endswith("less sure than their intervals say")


def test_a_named_effect_is_drawn_where_it_does_most_and_shares_stand_in_tables(answer, pair, probe):
    found = diagnose_pairs([pair(seed, probe) for seed in range(3)])
    drawn = pictures.effect_picture(found.evidence, found.document["effects"][0])
    assert drawn.alt == f"{NAME}: lag of one sensor"
    said = "Lag of one sensor: tau_s 1.00 s (0.90 to 1.10). Shown is the pu"
    assert drawn.caption.startswith(said)
    assert "nan" not in drawn.svg.lower()
    made = page.budget_page(found.document, found.evidence)
    assert not made.failed
    assert said in made.html
    phases, regimes = page.phase_table(found.document), page.regime_table(found.document)
    largest = max(cell.level for row in phases.rows for cell in row)
    assert largest == found.document["where"][0]["share"] > 0.5
    low = regimes.head.index("power low")
    shares = [float(cell.text[:-2]) for row in regimes.rows for cell in row[low : low + 3]]
    assert sum(shares) == pytest.approx(100.0, abs=3.0)


def test_a_picture_that_cannot_be_drawn_costs_nothing_but_itself(answer, pair, probe, monkeypatch):
    def broken(*_given):
        raise ValueError("no columns")

    found = diagnose_pairs([pair(seed, probe) for seed in range(3)])
    monkeypatch.setattr(pictures, "effect_picture", broken)
    made = page.budget_page(found.document, found.evidence)
    assert made.failed == (f"{NAME} could not be drawn (ValueError: no columns)",)
    assert made.failed[0] in made.html
    assert "Budget of the gap" in made.html
