"""Recorded and simulated logs are paired by name, and what does not belong together is refused."""

import numpy as np
import pytest

from eval.diagnosis.pairs import (
    alike,
    check_apart,
    match_simulated,
    pair_logs,
    read_folder,
    read_pairs,
    with_known_inputs,
)
from narxcal.support.errors import DataError
from training.config import RunConfig


@pytest.fixture
def folders(tmp_path, fly, record, write):
    """Two flights, recorded plain and simulated zipped."""
    for seed in range(2):
        sim = fly(seed, 60.0)
        write(tmp_path / "real" / f"a_{seed}.csv", record(sim, seed))
        write(tmp_path / "sim" / f"a_{seed}.csv.gz", sim)
    return tmp_path / "real", tmp_path / "sim"


def test_names_pair_files_whatever_their_ending(folders, fly):
    pairs = read_pairs(*folders)
    assert [pair.name for pair in pairs] == ["a_0", "a_1"]
    assert pairs[0].driver == "TRA_deg"
    assert tuple(pairs[0].sim) == ("N1_pct", "N2_pct", "EGT_C")
    assert tuple(pairs[0].inputs) == ("TRA_deg", "ALT_ft", "Mach", "dT_C", "NAI")
    np.testing.assert_allclose(pairs[1].sim["N1_pct"], fly(1, 60.0)["N1_pct"], rtol=1e-8)


def test_a_file_without_a_partner_is_named(folders, fly, write):
    write(folders[0] / "lone.csv", fly(2, 60.0))
    with pytest.raises(DataError, match=r"sim: 'lone' has no partner here \(1 of 3 logs"):
        read_pairs(*folders)
    (folders[0] / "lone.csv").unlink()
    (folders[0] / "a_1.csv").unlink()
    with pytest.raises(DataError, match=r"real: 'a_1' has no partner here"):
        read_pairs(*folders)


def test_two_files_of_one_name_are_refused(folders, fly, write):
    write(folders[0] / "a_0.csv.gz", fly(0, 60.0))
    with pytest.raises(DataError, match="two files have one name"):
        read_pairs(*folders)


def test_a_folder_that_is_missing_or_empty_is_named(tmp_path):
    with pytest.raises(DataError, match="does not exist"):
        read_folder(tmp_path / "none")
    with pytest.raises(DataError, match=r"holds no \.csv"):
        read_folder(tmp_path)


def test_a_configuration_maps_columns_of_several_engines(tmp_path, fly, record, write):
    sim = fly(0, 60.0)
    real = record(sim)
    columns = {"t": real["time_s"], "power": real["TRA_deg"]}
    for side in ("l", "r"):
        columns |= {f"{side}_{n}": real[n] for n in ("N1_pct", "N2_pct", "EGT_C")}
        write(tmp_path / "sim" / f"x_{side}.csv", sim)
    write(tmp_path / "real" / "x.csv", columns)
    outputs = {n: {"column": "{engine}_" + n} for n in ("N1_pct", "N2_pct", "EGT_C")}
    config = RunConfig.parse(
        {
            "schema": "narxcal.config/1",
            "logs": {
                "engines": {"l": "l", "r": "r"},
                "columns": {"time_s": {"column": "t"}, "TRA_deg": {"column": "power"}, **outputs},
            },
        }
    )
    pairs = read_pairs(tmp_path / "real", tmp_path / "sim", config)
    assert [pair.name for pair in pairs] == ["x_l", "x_r"]
    assert "ALT_ft" in pairs[0].inputs  # only the simulated log has it


def test_a_simulator_makes_the_logs_that_there_are_not(folders):
    def twice(log):
        return dict.fromkeys(("N1_pct", "EGT_C"), 2.0 * log["TRA_deg"])

    found = read_pairs(folders[0], twice)[0]
    assert tuple(found.sim) == ("N1_pct", "EGT_C")
    np.testing.assert_allclose(found.sim["N1_pct"], 2.0 * found.inputs["TRA_deg"])


@pytest.mark.parametrize("missing_s", [1.0, 5.0])
def test_nothing_is_compared_where_a_simulator_ran_on_a_held_input(fly, log_of, missing_s):
    log = log_of(fly(0, 60.0))
    here = (log.time_s >= 20.0) & (log.time_s < 20.0 + missing_s)
    log = log.with_channels({"TRA_deg": np.where(here, np.nan, log["TRA_deg"])})
    found = with_known_inputs(log, (), longest_s=2.0)
    twice = (log.time_s >= 20.0) & (log.time_s < 20.0 + 2.0 * missing_s)
    expected = twice if missing_s > 2.0 else np.zeros(len(log), dtype=bool)
    np.testing.assert_array_equal(~np.isfinite(found["N1_pct"]), expected)
    np.testing.assert_array_equal(~np.isfinite(found["TRA_deg"]), here)
    assert sum(one.samples for one in found.audit.entries) == expected.sum()


def test_rounding_of_inputs_is_no_difference(fly, record, log_of):
    sim = fly(0, 60.0)
    rounded = {**sim, "ALT_ft": sim["ALT_ft"].round(-1), "TRA_deg": sim["TRA_deg"].round(1)}
    found = pair_logs("f", log_of(record(rounded)), log_of(sim))
    np.testing.assert_array_equal(found.inputs["ALT_ft"], sim["ALT_ft"])


def test_last_samples_are_cut_and_counted_and_no_more(fly, record, log_of):
    sim = fly(0, 60.0)
    short = {name: values[:-10] for name, values in record(sim).items()}
    found = pair_logs("f", log_of(short), log_of(sim))
    assert found.counts["cut at the end"] == 10
    assert len(found.time_s) == len(sim["time_s"]) - 10


def test_clocks_that_start_apart_are_paired_by_row(fly, record, log_of):
    sim = fly(0, 60.0)
    later = {**record(sim), "time_s": sim["time_s"] + 4000.0}
    assert "paired by row, for the clocks start apart" in (
        pair_logs("f", log_of(later), log_of(sim)).counts
    )


def test_unknown_samples_are_masked_and_counted(fly, record, log_of):
    sim = fly(0, 60.0)
    real = record(sim)
    real["N2_pct"][100:130] = np.nan
    real["TRA_deg"][5:8] = np.nan
    broken = {**sim, "N1_pct": sim["N1_pct"].copy()}
    broken["N1_pct"][50:55] = np.nan
    found = pair_logs("f", log_of(real), log_of(broken))
    assert found.counts["N2_pct unknown"] == 30
    assert found.counts["N1_pct simulated missing"] == 5
    assert np.isnan(found.real["N1_pct"][50:55]).all()
    assert np.isfinite(found.sim["N1_pct"]).all()
    assert np.isfinite(found.inputs["TRA_deg"]).all()


def without(channels, *names):
    return {name: values for name, values in channels.items() if name not in names}


def test_fuel_flow_is_an_output_beside_a_lever_and_the_driver_without(fly, log_of):
    sim = fly(0, 60.0)
    sim["FF_kgph"] = 100.0 + 10.0 * sim["N2_pct"]
    found = pair_logs("f", log_of(sim), log_of(sim))
    assert "FF_kgph" in found.sim
    assert "FF_kgph" not in found.inputs
    bare = without(sim, "TRA_deg")
    found = pair_logs("f", log_of(bare), log_of(bare))
    assert found.driver == "FF_kgph"
    assert "FF_kgph" not in found.sim


def test_thrust_is_compared_and_not_diagnosed(fly, log_of):
    sim = fly(0, 60.0)
    sim["FN_kN"] = 0.1 * sim["N1_pct"]
    found = pair_logs("f", log_of(sim), log_of(sim))
    assert "FN_kN" not in found.sim
    assert found.others["FN_kN"].shape == (960, 2)


def test_flights_with_other_drivers_are_refused(tmp_path, fly, write):
    for name in ("a", "b"):
        sim = fly(0, 60.0)
        if name == "b":
            sim = {**without(sim, "TRA_deg"), "FF_kgph": 10.0 * sim["N2_pct"]}
        for folder in ("real", "sim"):
            write(tmp_path / folder / f"{name}.csv", sim)
    with pytest.raises(DataError, match="is driven by FF_kgph, but a by TRA_deg"):
        read_pairs(tmp_path / "real", tmp_path / "sim")


def test_the_simulated_log_of_a_name_or_what_a_simulator_makes(fly, log_of):
    sim = log_of(fly(0, 60.0))
    bare = log_of(without(fly(0, 60.0), "N1_pct", "N2_pct", "EGT_C"))
    assert "N1_pct" in match_simulated("f", bare, {"f": sim}).channels
    made = match_simulated("f", bare, lambda log: {"N1_pct": log["TRA_deg"]})
    assert set(made.channels) == {*bare.channels, "N1_pct"}
    with pytest.raises(DataError, match=r"no simulated log of this name\. There are f"):
        match_simulated("g", bare, {"f": sim})


def test_values_that_no_engine_has_are_unknown_without_a_configuration(folders, fly, record, write):
    real = record(fly(0, 60.0))
    real["N1_pct"][100:104], real["EGT_C"][5] = 9999.0, -999.0
    write(folders[0] / "a_0.csv", real)
    pair = read_pairs(*folders)[0]
    assert np.isnan(pair.real["N1_pct"][100:104]).all()
    assert np.isnan(pair.real["EGT_C"]).sum() == 1
    assert pair.counts["N1_pct masked: out of range"] == 4
    assert pair.counts["EGT_C masked: out of range"] == 1


def test_endings_may_be_capital_and_hidden_files_are_no_logs(folders):
    real = folders[0]
    (real / "a_0.csv").rename(real / "a_0.CSV")
    (real / "._a_0.csv").write_bytes(b"\x00\x05\x16\x07")
    assert [pair.name for pair in read_pairs(*folders)] == ["a_0", "a_1"]


def test_a_held_out_flight_is_none_of_the_diagnosis_under_any_name(fly, record, log_of):
    def pair(name, seed):
        sim = fly(seed, 60.0)
        return pair_logs(name, log_of(record(sim, seed)), log_of(sim))

    pairs = [pair("a", 0), pair("b", 1)]
    check_apart(pairs, [pair("a", 2), pair("c", 3)])
    with pytest.raises(DataError) as caught:
        check_apart(pairs, [pair("c", 3), pair("d", 1)])
    assert str(caught.value) == (
        "d: the held-out flight is 'b' of the diagnosis: nothing could be checked on it. Hold "
        "flights out that are not among those of --real"
    )


def test_clocks_of_recorders_may_differ_by_a_few_in_a_thousand(pair):
    flights = [pair(0), pair(1, rate_hz=16.02)]
    assert len(alike(flights)) == 2
    with pytest.raises(DataError, match=r"flight_1: recorded at 16\.5 Hz, but flight_0 at 16 Hz"):
        alike([pair(0), pair(1, rate_hz=16.5)])
