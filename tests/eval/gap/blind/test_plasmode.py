"""Real flights with an effect added exactly: what changes, what does not, what is refused."""

import numpy as np
import pandas as pd
import pytest

from eval.gap.blind import plasmode
from eval.gap.blind.cases import BlindPlan
from eval.gap.blind.catalogue import CATALOGUE, Dose
from eval.gap.blind.files import open_key
from eval.gap.blind.injected import EFFECTS, Injector, possible
from eval.gap.blind.make import write_key
from eval.gap.blind.plasmode import Real, make_real_cases
from narxcal.flight_test.sensors import first_order
from narxcal.support.errors import ConfigError, DataError

PLAN = BlindPlan(cases=8, flights=2, held_out=1, seed=1)


def lags(inputs, dt_s):
    driver = inputs["TRA_deg"] / 85.0 if "TRA_deg" in inputs else inputs["FF_kgph"] / 500.0
    power = first_order(np.asarray(driver), 1.5, dt_s)
    return {"N1_pct": 25.0 + 70.0 * power, "EGT_C": 400.0 + 350.0 * power}


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    """The function above as a module of the folder that the command runs in."""
    folder = tmp_path_factory.mktemp("simulator")
    (folder / "real_lags.py").write_text(
        "import numpy as np\n"
        "from narxcal.flight_test.sensors import first_order\n"
        "def lags(inputs, dt_s):\n"
        "    driver, full = ('TRA_deg', 85) if 'TRA_deg' in inputs else ('FF_kgph', 500)\n"
        "    power = first_order(np.asarray(inputs[driver]) / full, 1.5, dt_s)\n"
        "    return {'N1_pct': 25 + 70 * power, 'EGT_C': 400 + 350 * power}\n",
        "utf-8",
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield "real_lags:lags"


def write_flights(folder, *, driver="TRA_deg", duration_s=2000.0, still=False):
    """Two flights at 4 Hz, with slams, noise and half a minute without EGT."""
    folder.mkdir()
    for number in range(2):
        random = np.random.default_rng(number)
        time_s = np.arange(0.0, duration_s, 0.25)
        level = np.where((time_s // 40.0) % 2, 0.8, 0.3) + 0.05 * np.sin(time_s / 90.0)
        level = 0.5 + 0.0 * level if still else level
        inputs = {driver: level * (85.0 if driver == "TRA_deg" else 500.0)}
        found = {"time_s": time_s, **inputs, "ALT_ft": 5000.0 + time_s, **lags(inputs, 0.25)}
        found["N1_pct"] = found["N1_pct"] + 0.5 + 0.05 * random.standard_normal(len(time_s))
        found["EGT_C"] = found["EGT_C"] + 4.0 + random.standard_normal(len(time_s))
        found["EGT_C"][100:220] = np.nan
        pd.DataFrame(found).to_csv(folder / f"flight_{number}.csv", index=False)
    return folder


@pytest.fixture(scope="module", params=["TRA_deg", "FF_kgph"])
def cases(request, simulator, tmp_path_factory):
    """Cases in a folder beside the flights that they were made from."""
    place = tmp_path_factory.mktemp("plasmode")
    flights = write_flights(place / "flights", driver=request.param)
    folder = place / "cases"
    folder.mkdir()
    write_key(folder, PLAN, "1", make_real_cases(folder, PLAN, Real(flights, simulator)))
    return folder


def read(file):
    return pd.read_csv(file)


def test_only_the_effect_is_added(cases):
    key = open_key(cases, "1")["cases"]
    names = {row["effects"][0]["id"] for row in key.values()}
    assert "throttle_delay" in names
    assert {"sensor_lag", "sensor_bias", "sensor_drift", "time_skew"} >= {
        name for name in names if name != "throttle_delay" and name not in EFFECTS
    }
    assert names & set(EFFECTS)
    for name, row in key.items():
        effect = row["effects"][0]
        log, start, stop = row["pieces"][0]
        was = read(cases.parent / "flights" / f"{log}.csv").iloc[start:stop].reset_index(drop=True)
        real = read(cases / name / "real" / "flight_0.csv.gz")
        sim = read(cases / name / "sim" / "flight_0.csv.gz")
        driver = "TRA_deg" if "TRA_deg" in was else "FF_kgph"
        np.testing.assert_array_equal(real[driver], sim[driver])
        for output in ("N1_pct", "EGT_C"):
            same = np.allclose(real[output], was[output], rtol=1e-6, equal_nan=True)
            if effect["id"] not in EFFECTS:
                assert same == (output != effect["channel"])
            elif output == "N1_pct":
                assert not same
        later = np.interp(
            was["time_s"] + effect["parameters"].get("delay_s", 0.0), was["time_s"], was[driver]
        )
        inner = slice(0, len(was) - 40)
        np.testing.assert_allclose(real[driver][inner], later[inner], rtol=1e-6)
        assert row["kind"] == "single"
        assert row["gap_share"] < 1.0


def test_a_drift_begins_anew_in_every_piece(simulator, tmp_path, monkeypatch):
    """Every piece is a flight of its own: the instrument is warm at the start of none of them."""
    drifts = [each for each in CATALOGUE if each.id == "sensor_drift"]
    monkeypatch.setattr(plasmode, "CATALOGUE", drifts)
    flights = write_flights(tmp_path / "flights")
    case = made(flights, simulator, tmp_path, BlindPlan(cases=1, flights=2, held_out=1, seed=1))[0]
    effect = case.row["effects"][0]
    for number, (log, start, stop) in enumerate(case.row["pieces"][: PLAN.flights]):
        was = read(flights / f"{log}.csv").iloc[start:stop].reset_index(drop=True)
        real = read(tmp_path / "out" / case.name / "real" / f"flight_{number}.csv.gz")
        ramp = (real[effect["channel"]] - was[effect["channel"]]).dropna()
        per_s = effect["parameters"]["rate_per_h"] / 3600.0
        np.testing.assert_allclose(ramp, per_s * real["time_s"][ramp.index], atol=1e-3)


@pytest.mark.parametrize("driver", ["TRA_deg", "FF_kgph"])
def test_what_acts_inside_is_the_difference_that_it_makes_in_a_lumped_engine(driver):
    time_s = np.arange(0.0, 300.0, 0.125)
    channels = {driver: np.where((time_s // 40.0) % 2, 40.0, 12.0), "ALT_ft": 9000.0 + 0.0 * time_s}
    injector = Injector(channels, driver, 0.125)
    scales = {each.id: each for each in CATALOGUE}
    slow = Dose(scales["spool_lag"], 0.5)
    spans = {"N1_pct": 60.0, "EGT_C": 400.0, "FF_kgph": 900.0}
    one = injector.change(slow, (), spans)
    assert set(one) == {"N1_pct", "EGT_C"}
    assert np.abs(one["N1_pct"]).max() > 3.0
    rest = np.abs(one["N1_pct"][time_s % 40.0 > 39.0])
    assert rest.max() < 0.25 * np.abs(one["N1_pct"]).max()
    two = injector.change(slow, (), {name: 2.0 * span for name, span in spans.items()})
    np.testing.assert_allclose(two["EGT_C"], 2.0 * one["EGT_C"])
    none = injector.change(Dose(scales["spool_lag"], 0.0), (), spans)
    np.testing.assert_allclose(none["N1_pct"], 0.0, atol=1e-9)
    assert possible(driver, ("N1_pct", "EGT_C"), "spool_lag")
    assert not possible(driver, ("EGT_C", "FF_kgph"), "spool_lag")
    assert not possible(driver, ("N1_pct", "EGT_C"), "throttle_backlash")


@pytest.mark.slow
def test_the_same_plan_gives_the_same_bytes(cases, simulator, tmp_path):
    again = tmp_path / "again"
    again.mkdir()
    real = Real(cases.parent / "flights", simulator)
    write_key(again, PLAN, "1", make_real_cases(again, PLAN, real))
    for file in cases.rglob("*"):
        if file.is_file():
            assert file.read_bytes() == (again / file.relative_to(cases)).read_bytes()


def made(flights, simulator, tmp_path, plan=PLAN):
    return list(make_real_cases(tmp_path / "out", plan, Real(flights, simulator)))


def test_what_cannot_be_made(simulator, tmp_path):
    flights = write_flights(tmp_path / "flights")
    with pytest.raises(ConfigError, match="need a simulator that can be run again"):
        made(flights, str(flights), tmp_path)
    many = PLAN.model_copy(update={"flights": 30})
    with pytest.raises(DataError, match="give 8 pieces of 480 s in which the TRA_deg moves"):
        made(flights, simulator, tmp_path, many)
    still = write_flights(tmp_path / "still", still=True)
    file = still / "flight_0.csv"
    table = read(file)
    table.loc[0, "TRA_deg"] = 80.0
    table.to_csv(file, index=False)
    with pytest.raises(DataError, match="give 1 pieces of 480 s"):
        made(still, simulator, tmp_path)


def test_flights_without_driver_or_common_output(simulator, tmp_path):
    flights = write_flights(tmp_path / "flights")
    for number, gone in ((0, ["TRA_deg"]), (1, ["TRA_deg"])):
        file = flights / f"flight_{number}.csv"
        read(file).drop(columns=gone).to_csv(file, index=False)
    with pytest.raises(DataError, match="a log has neither TRA_deg nor FF_kgph"):
        made(flights, simulator, tmp_path)
    other = write_flights(tmp_path / "other")
    for number in (0, 1):
        file = other / f"flight_{number}.csv"
        renamed = {"N1_pct": "N2_pct"}
        read(file).drop(columns="EGT_C").rename(columns=renamed).to_csv(file, index=False)
    with pytest.raises(ConfigError, match="the simulator gives no output that all flights have"):
        made(other, simulator, tmp_path)
