"""The energy map finds planted gaps, ignores noise and nuisances, and is honest on few flights."""

import numpy as np
import pytest

from eval.diagnosis.flights import MOVES, events_of, moves_of
from eval.diagnosis.where import locate, side_of, without_nuisances
from training.diagnosis.metric import TOLERANCE


def test_a_lagging_probe_is_on_its_channel_while_things_move(make_data, probe):
    where = locate(make_data(probe))
    assert where.rows[0].channel == "EGT_C"
    assert where.rows[0].phase == "transit"
    assert where.channels["EGT_C"].value > 0.97
    assert all(row.phase != "steady" for row in where.rows if row.core)
    assert where.side.sensor > 0.9
    assert where.excess["EGT_C"] > 0.9
    assert where.times["EGT_C"].groupby("direction")["Tt_s"].median()["push"] > 0.5


def test_shares_are_a_partition_with_intervals_around_them(make_data, probe):
    where = locate(make_data(probe))
    assert sum(row.share.value for row in where.rows) == pytest.approx(1.0)
    assert all(0 <= row.share.low <= row.share.value <= row.share.high <= 1 for row in where.rows)
    values = [row.share.value for row in where.rows]
    assert values == sorted(values, reverse=True)
    for row in where.rows:
        for levels in row.regimes.values():
            assert sum(levels.values()) == pytest.approx(1.0)


def test_the_core_is_the_smallest_set_that_holds_70_percent(make_data, probe):
    where = locate(make_data(probe))
    core = [row.share.value for row in where.rows if row.core]
    assert sum(core) >= 0.7
    assert sum(core[:-1]) < 0.7


def planted(data, direction, phase, size=0.02):
    """A gap of `size` ranges on N2 in one bin alone."""
    move = moves_of(data, events_of(data))
    data.real[..., 1] += np.where(move == MOVES.index((direction, phase)), size * data.span[1], 0.0)
    return data


@pytest.mark.parametrize(
    ("direction", "phase"),
    [("steady", "steady"), ("push", "settling"), ("pull", "transit"), ("push", "initiation")],
)
def test_a_gap_in_one_bin_is_found_in_that_bin(make_data, direction, phase):
    where = locate(planted(make_data(), direction, phase))
    first = where.rows[0]
    assert (first.channel, first.direction, first.phase) == ("N2_pct", direction, phase)
    assert first.share.value > 0.95


def test_noise_alone_is_nowhere(make_data):
    where = locate(make_data())
    assert sum(row.share.value for row in where.rows) < 1e-9
    assert where.side == (0.0, 0.0, 0.0)
    assert max(where.excess.values()) < 0.1


def test_what_an_effect_does_is_told_apart_from_the_rest_of_the_gap(make_data):
    data = planted(make_data(), "steady", "steady", 0.05)
    explained = np.zeros_like(data.flights.y)
    move = moves_of(data, events_of(data))
    explained[..., 0] = np.where(move == MOVES.index(("push", "transit")), 1.0, 0.0)
    explained[..., 2] = np.where(move == MOVES.index(("pull", "transit")), 1.0, 0.0)
    rows = {(row.channel, row.direction, row.phase): row for row in locate(data, explained).rows}
    first = rows["N2_pct", "steady", "steady"]
    assert (first.core, first.explained) == (True, 0.0)
    fan, hot = rows["N1_pct", "push", "transit"], rows["EGT_C", "pull", "transit"]
    assert not fan.core
    assert fan.explained + hot.explained == pytest.approx(1.0)
    scale = data.noise**2 + (TOLERANCE * data.span) ** 2
    pushed, pulled = ((explained[..., k] > 0.0).sum() / scale[k] for k in (0, 2))
    assert fan.explained == pytest.approx(pushed / (pushed + pulled))


def test_without_a_claim_nothing_is_told_of_what_effects_do(make_data, probe):
    data = make_data(probe)
    for explained in (None, np.zeros_like(data.flights.y)):
        assert {row.explained for row in locate(data, explained).rows} == {None}


def test_what_was_not_recorded_is_not_told_of(make_data, probe):
    data = make_data(probe)
    explained = data.difference.copy()
    data.real[..., 0] = np.nan
    explained[..., 0] = 100.0
    rows = locate(data, explained).rows
    assert sum(row.explained for row in rows if row.channel == "EGT_C") > 0.95


def test_offsets_of_flights_are_no_gap_beside_an_effect(make_data, probe):
    data = make_data(probe)
    offsets = np.array([0.4, -0.3, 0.5, -0.5])
    data.real[..., 0] += offsets[:, None]
    assert locate(data).channels["N1_pct"].value > 0.02
    truth = make_data(probe).difference
    explained = np.zeros_like(data.flights.y)
    explained[..., 2] = truth[..., 2]
    where = locate(data, explained)
    assert where.channels["N1_pct"].value < 0.005
    kept = without_nuisances(data, explained)[..., 2]
    np.testing.assert_allclose(kept, truth[..., 2], atol=0.5)


def test_regimes_tell_where_a_bin_has_its_energy(make_data):
    data = planted(make_data(), "steady", "steady")
    hot = data.flights.u[..., data.flights.signals.u("NAI")] > 0.5
    data.real[..., 1] = np.where(hot, data.real[..., 1], data.flights.y[..., 1])
    found = locate(data).rows[0].regimes
    assert found["bleed"]["NAI"] > 0.98
    assert 0.0 < found["altitude"]["mid"] < 1.0


def test_one_flight_has_an_interval_too(make_data, probe):
    def width(flights):
        data = make_data(probe, flights=flights)
        data.real[:, ::7, 1] += 0.02 * data.span[1] * np.arange(1, flights + 1)[:, None]
        row = locate(data).rows[0]
        return row.share.high - row.share.low

    assert width(1) > 0.0
    assert width(2) > 0.0
    assert 0.0 < width(8) < 0.5


def test_unknown_samples_take_no_part(make_data, probe):
    data = make_data(probe)
    data.real[0] = np.nan
    data.real[0, :400] = data.flights.y[0, :400]
    assert locate(data).rows[0].channel == "EGT_C"


def test_a_shift_of_all_channels_is_on_the_input_side(make_data):
    data = make_data()
    data.real[:] = np.roll(data.flights.y, 2, axis=1)
    data.real[:, :2] = data.flights.y[:, :2]
    energy = (data.difference / data.span) ** 2
    side = side_of(data, data.difference, energy.sum(axis=(0, 1)))
    assert side.input > 0.7
    assert sum(side) == pytest.approx(1.0)


def test_slower_spools_are_on_the_process_side(make_data):
    data = make_data()
    for k, size in enumerate((0.02, -0.02, 0.02)):
        power = data.flights.signals.power(data.flights.y)
        data.real[..., k] = data.flights.y[..., k] + size * data.span[k] * (power - 0.5)
    side = side_of(data, data.difference, np.array([0.4, 0.3, 0.3]))
    assert side.process > 0.9


def test_each_regime_adds_up_to_the_whole_with_intervals(make_data, probe):
    found = locate(make_data(probe)).regimes
    assert {"power", "altitude", "Mach", "bleed"} == set(found)
    for levels in found.values():
        assert sum(share.value for share in levels.values()) == pytest.approx(1.0)
        assert all(share.low <= share.value <= share.high for share in levels.values())
    assert found["Mach"]["mid"].value == pytest.approx(1.0)


def test_a_gap_at_high_power_is_there(make_data):
    def biased(sim):
        high = sim["N1_pct"] > 25.0 + 75.0 * 50.0 / 70.0
        return {"EGT_C": sim["EGT_C"] + 30.0 * high}

    power = locate(make_data(biased)).regimes["power"]
    assert power["high"].value > 0.9
