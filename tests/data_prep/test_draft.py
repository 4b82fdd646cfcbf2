"""A configuration drafted from logs: what they settle is settled, what they do not is open."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from data_prep.derive import units_that_agree
from data_prep.drafting.draft import draft
from data_prep.drafting.naming import read_name
from narxcal.atmosphere import KELVIN, SOUND_KT, isa
from narxcal.support.settings import OPEN

DATA = Path(__file__).parents[3] / "shared" / "data"
TIME_S = np.arange(1200) / 10.0
SPEED_PCT = 70.0 + 25.0 * np.sin(TIME_S / 9.0)
ALT_FT = np.linspace(2000.0, 30000.0, 1200)
MACH = np.linspace(0.35, 0.78, 1200)


def air():
    """Air data in canonical units that belong together."""
    kelvin = isa(ALT_FT)[0] + 7.0
    tas = MACH * SOUND_KT * np.sqrt(kelvin / 288.15)
    return {
        "ALT_ft": ALT_FT,
        "Mach": MACH,
        "TAS_kt": tas,
        "SAT_C": kelvin - KELVIN,
        "TAT_C": kelvin * (1.0 + 0.2 * MACH**2) - KELVIN,
    }


UNITS = {"ALT_ft": ("ft", "m"), "TAS_kt": ("kt", "km/h", "m/s"),
         "SAT_C": ("degC", "K", "degF"), "TAT_C": ("degC", "K", "degF")}  # fmt: skip


@pytest.mark.parametrize("name", ["TAS_kt", "SAT_C", "TAT_C"])
@pytest.mark.parametrize("number", [0, 1])
def test_air_data_agree_in_their_own_units_alone(name, number):
    written = UNITS[name][number]
    scale, offset = {"km/h": (1.852, 0.0), "K": (1.0, KELVIN)}.get(written, (1.0, 0.0))
    found = units_that_agree({**air(), name: air()[name] * scale + offset}, UNITS)
    assert found[name] == written


def test_air_data_alone_on_the_ground_settle_nothing():
    still = {name: values[:1] + 0.0 * values for name, values in air().items()}
    assert units_that_agree({**still, "Mach": 0.0 * MACH}, UNITS) == {}


def csv(folder, header, *columns, name="log.csv"):
    path = folder / name
    table = np.column_stack(columns)
    np.savetxt(path, table, fmt="%.10g", delimiter=",", header=header, comments="")
    return path


def lines(found):
    return {line.channel: line.keys for line in found.lines}


def test_what_name_and_data_say_is_settled_and_the_rest_is_open(tmp_path):
    path = csv(
        tmp_path,
        "Time,Eng1 TLA,Eng1 N1,Eng2 N1,Eng1 EGT (deg F),Eng2 EGT (deg F),Eng1 FF,Eng2 FF,Altitude",
        *(TIME_S, SPEED_PCT / 2, SPEED_PCT, SPEED_PCT - 1, *2 * [900 + 5 * SPEED_PCT]),
        *(*2 * [20 * SPEED_PCT], ALT_FT),
    )
    found = draft([path])
    assert found.engines == {"engine1": "1", "engine2": "2"}
    assert lines(found) == {
        "time_s": {"column": "Time", "unit": "s"},
        "N1_pct": {"column": "Eng{engine} N1", "unit": "%"},
        "EGT_C": {"column": "Eng{engine} EGT (deg F)", "unit": "degF"},
        "FF_kgph": {"column": "Eng{engine} FF", "unit": OPEN},
        "ALT_ft": {"column": "Altitude", "unit": "ft"},
        "TRA_deg": {"column": "Eng{engine} TLA", "unit": "deg", "optional": True},
    }
    assert all(line.why for line in found.lines)


EGT, GROUND = 400 + 4 * SPEED_PCT, (TIME_S < 50.0).astype(float)
SWITCH = {"unit": "0/1", "optional": True}
FILES = {
    "revolutions": (
        ("t,N1 (RPM),EGT_C", TIME_S, SPEED_PCT, EGT),
        {"N1_pct": {"column": "N1 (RPM)", "scale": OPEN}},
    ),
    "a flow of volume": (
        ("t,N1,FF (gal/h)", TIME_S, SPEED_PCT, 20 * SPEED_PCT),
        {"FF_kgph": {"column": "FF (gal/h)", "density_kgpl": OPEN}},
    ),
    "a unit that is not known": (
        ("t,N1,EGT (furlong)", TIME_S, SPEED_PCT, EGT),
        {"EGT_C": {"column": "EGT (furlong)", "unit": OPEN}},
    ),
    "revolutions for a percentage that is not proportional": (
        ("time_s,rpm,rpm_pct", TIME_S, 400.0 * SPEED_PCT, SPEED_PCT**2 / 100.0),
        {"N1_pct": {"column": "rpm", "scale": OPEN}, "unused": {"rpm_pct": "N1_pct is 'rpm'"}},
    ),
    "nothing known": (
        ("a,b,c", TIME_S[::-1], SPEED_PCT, SPEED_PCT),
        {"time_s": {"column": OPEN}, "unknown": ("a", "b", "c")},
    ),
    "a comment for a header": (
        ("# time_s,N1_pct,EGT_C", TIME_S, SPEED_PCT, EGT),
        {"time_s": {"column": "time_s", "unit": "s"}, "unknown": ()},
    ),
    "cylinders, which are no engines": (
        ("time,RPM,EGT1 (deg F),EGT2 (deg F)", TIME_S, *3 * [30 * SPEED_PCT]),
        {
            "EGT_C": {"column": "EGT1 (deg F)", "unit": "degF"},
            "engines": {},
            "unused": {"EGT2 (deg F)": "EGT_C is 'EGT1 (deg F)'"},
        },
    ),
    "a lever of one engine alone": (
        ("time_s,N1 L,N1 R,Throttle L", TIME_S, SPEED_PCT, SPEED_PCT, SPEED_PCT),
        {
            "TRA_deg": {"column": "Throttle {engine}", "unit": "deg", "optional": True},
            "engines": {"left": "L", "right": "R"},
        },
    ),
    "a channel that stands still": (
        ("time_s,N1,EGT_C", TIME_S, 0.0 * TIME_S, EGT),
        {"unused": {"N1": "without a value that changes"}},
    ),
    "a switch by its name": (
        ("time_s,N1_pct,WOW", TIME_S, SPEED_PCT, GROUND),
        {"WOW": {"column": "WOW", **SWITCH}},
    ),
    "a switch that may be on in flight": (
        ("time_s,N1_pct,Air Ground", TIME_S, SPEED_PCT, GROUND),
        {"WOW": {"column": "Air Ground", **SWITCH, "scale": OPEN}},
    ),
}


@pytest.mark.parametrize(("file", "wanted"), FILES.values(), ids=FILES)
def test_what_files_say_alone_and_what_is_asked_for(tmp_path, file, wanted):
    found = draft([csv(tmp_path, *file)])
    assert {**vars(found), **lines(found)}.items() >= wanted.items()


def test_a_test_cell_has_a_speed_and_air_by_its_units(tmp_path):
    path = csv(
        tmp_path,
        "t [s],WF [g/s],N [rpm],T5 [degC],PBARO [hPa],TCELL [degC],Valve,Bus [V]",
        *(TIME_S, 2 * SPEED_PCT, 142 * SPEED_PCT, 4 * SPEED_PCT),
        *(1000 + TIME_S / 50, 15 + TIME_S / 50, TIME_S, TIME_S),
    )
    found = draft([path])
    assert lines(found) == {
        "time_s": {"column": "t [s]", "unit": "s"},
        "ALT_ft": {"column": "PBARO [hPa]", "unit": "hPa"},
        "N1_pct": {"column": "N [rpm]", "scale": OPEN},
        "EGT_C": {"column": "T5 [degC]", "unit": "degC"},
        "FF_kgph": {"column": "WF [g/s]", "unit": "g/s"},
        "SAT_C": {"column": "TCELL [degC]", "unit": "degC"},
    }
    assert found.unknown == ("Valve", "Bus [V]")


def test_channels_with_rates_need_no_stamps(tmp_path):
    path = tmp_path / "flight.mat"
    channels = {
        "N1_1": (SPEED_PCT, 4.0, "%RPM"), "N1_2": (SPEED_PCT, 4.0, "%RPM"),
        "PLA_1": (SPEED_PCT / 2, 4.0, "DEG"), "PLA_2": (SPEED_PCT / 2, 4.0, "DEG"),
        "ALT": (ALT_FT[::4], 1.0, "FEET"), "N1T": (SPEED_PCT, 4.0, "%"),
    }  # fmt: skip
    savemat(
        path,
        {name: dict(zip(("data", "Rate", "Units"), each, strict=True))
         for name, each in channels.items()},
    )  # fmt: skip
    found = draft([path])
    assert found.engines == {"engine1": "1", "engine2": "2"}
    assert lines(found) == {
        "time_s": {"column": "time_s", "unit": "s"},
        "TRA_deg": {"column": "PLA_{engine}", "unit": "deg"},
        "N1_pct": {"column": "N1_{engine}", "unit": "%"},
        "ALT_ft": {"column": "ALT", "unit": "ft"},
    }


@pytest.mark.parametrize(("on_ground", "keys"), [(1, {}), (0, {"scale": -1.0, "offset": 1.0})])
def test_a_switch_that_is_on_in_flight_is_turned_round(tmp_path, on_ground, keys):
    speed = np.clip(3.0 * TIME_S - 60.0, 0.0, 200.0)
    ground = np.where(speed < 90.0, on_ground, 1 - on_ground)
    rows = (TIME_S, SPEED_PCT, speed, ground)
    found = lines(draft([csv(tmp_path, "time_s,N1_pct,CAS_kt,Air Ground", *rows)]))
    wanted = {"column": "Air Ground", "unit": "0/1", "optional": True, **keys}
    assert found["WOW"] == wanted


def test_the_seconds_of_a_day_are_no_days(tmp_path):
    found = draft([csv(tmp_path, "SecOfDay,N1,EGT_C", 7e4 + TIME_S, SPEED_PCT, 8 * SPEED_PCT)])
    assert lines(found)["time_s"] == {"column": "SecOfDay", "unit": "s"}


def test_a_time_that_may_be_in_ms_is_asked_for_and_read_so(tmp_path):
    found = draft([csv(tmp_path, "t,N1,EGT_C", 1000.0 * TIME_S, SPEED_PCT, 8 * SPEED_PCT)])
    assert lines(found)["time_s"] == {"column": "t", "unit": OPEN}
    assert found.logs().columns["time_s"].unit == "ms"


def test_a_clock_of_seconds_is_no_time_where_channels_have_rates(tmp_path):
    channels = {"GMT_SEC": TIME_S % 60.0, "N1_1": SPEED_PCT, "EGT_1": 400 + 4 * SPEED_PCT}
    path = tmp_path / "flight.mat"
    units = {"GMT_SEC": "SECONDS", "N1_1": "%RPM", "EGT_1": "DEG"}
    savemat(
        path,
        {
            name: {"data": each, "Rate": 4.0, "Units": units[name]}
            for name, each in channels.items()
        },
    )
    found = lines(draft([path]))
    assert found["time_s"] == {"column": "time_s", "unit": "s"}
    assert found["EGT_C"] == {"column": "EGT_{engine}", "unit": OPEN}  # degrees of any scale


def test_the_header_is_the_row_that_the_rows_below_agree_with(tmp_path):
    path = tmp_path / "dau.csv"
    table = np.stack([TIME_S, ALT_FT, SPEED_PCT / 2, 60 * SPEED_PCT, 8 * SPEED_PCT], axis=1)
    head = (
        "Messanlage;DAU-7\nPruefer;M\xfcller; H.\nZeit;12:03:04\n"
        "Zeit;Druckh\xf6he;Leistungshebel;Drehzahl;Abgastemperatur\ns;m;Grad;U/min;\xb0C\n"
    )
    text = "\n".join(";".join(f"{x:.3f}".replace(".", ",") for x in row) for row in table)
    path.write_text(head + text, "cp1252")
    assert lines(draft([path])) == {
        "time_s": {"column": "Zeit", "unit": "s"},
        "TRA_deg": {"column": "Leistungshebel", "unit": "deg"},
        "ALT_ft": {"column": "Druckh\xf6he", "unit": "m"},
        "N1_pct": {"column": "Drehzahl", "scale": OPEN},
        "EGT_C": {"column": "Abgastemperatur", "unit": "degC"},
    }


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("Temps", "time_s"), ("_real,_time", "time_s"), ("tiempo [s]", "time_s"),
        ("R\xe9gime moteur", "N1_pct"),
        ("D\xe9bit de carburant [kg/h]", "FF_kgph"), ("Caudal de combustible", "FF_kgph"),
        ("Au\xdfentemperatur", "SAT_C"), ("Velocidad indicada", "CAS_kt"),
        ("Machzahl", "Mach"), ("Nombre de Mach", "Mach"), ("throttle_pos", "TRA_deg"),
        ("Temp\xe9rature statique (\xb0C)", "SAT_C"), ("Drehzahl N2", "N2_pct"),
        ("rec/eng1/N1", "N1_pct"), ("Fuel/Used", None),
    ],
)  # fmt: skip
def test_names_of_other_languages_and_within_structs(name, channel):
    read = read_name(name)
    assert (read and read.channel) == channel
    assert not read or read.template.replace("{engine}", read.engine) == name


def test_a_struct_of_arrays_and_of_other_things(tmp_path):
    path = tmp_path / "run1.mat"
    arrays = {"time": TIME_S, "N1": SPEED_PCT, "PLA": SPEED_PCT / 2, "EGT": np.ones(3)}
    savemat(path, {"rec": {**arrays, "fs": 10.0, "note": "cold"}})
    found = draft([path, path])
    assert lines(found) == {
        "time_s": {"column": "rec/time", "unit": "s"},
        "TRA_deg": {"column": "rec/PLA", "unit": "deg"},
        "N1_pct": {"column": "rec/N1", "unit": "%"},
    }
    assert found.unused == {"rec/EGT": "of other rows than the others"}


def test_of_two_clocks_the_one_that_can_be_read_is_taken(tmp_path):
    path = tmp_path / "two.csv"
    rows = (f"x{k % 7},{k / 10},{70 + k % 9}" for k in range(600))
    path.write_text("UTC,time [s],N1 [%]\n" + "\n".join(rows), "utf-8")
    found = draft([path])
    assert lines(found)["time_s"] == {"column": "time [s]", "unit": "s"}
    assert "expected a number" in found.unused["UTC"]


def test_dates_that_may_be_read_in_two_ways_are_asked_for(tmp_path):
    path = tmp_path / "dates.csv"
    rows = (f"03/04/2026 12:{k // 60:02d}:{k % 60:02d},{70 + k % 9}" for k in range(600))
    path.write_text("Timestamp,N1 [%]\n" + "\n".join(rows), "utf-8")
    assert draft([path]).assumed == {"dates": "DMY"}


@pytest.mark.parametrize("factor", [1.0, 1.0 / 1.852])
def test_a_unit_that_cannot_be_tested_is_asked_for(tmp_path, factor):
    """Below Mach 0.3 air data say nothing: in m/s they would, which makes it no m/s."""
    knots = factor * np.linspace(60.0, 120.0, 1200)
    rows = (TIME_S, 60 * SPEED_PCT, ALT_FT / 8, knots, knots * 1.03, 15.0 - ALT_FT / 4000)
    header = "time,RPM,AltB,IAS,TAS,OAT"
    found = lines(draft([csv(tmp_path, header, *rows)]))
    assert [found[name]["unit"] for name in ("ALT_ft", "CAS_kt", "TAS_kt")] == 3 * [OPEN]


def test_a_column_that_another_file_lacks_is_optional(tmp_path):
    first = csv(tmp_path, "time_s,N1_pct,EGT_C", TIME_S, SPEED_PCT, SPEED_PCT * 8)
    second = csv(tmp_path, "time_s,N1_pct", TIME_S, SPEED_PCT, name="other.csv")
    assert lines(draft([first, second]))["EGT_C"]["optional"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "engines", "open_"),
    [
        ("flights/citation_20190312_flight2.csv.gz", ["left", "right"], {"EGT_C", "FF_kgph"}),
        (
            "recorders/a321/a321_flight.csv.gz",
            ["engine1", "engine2"],
            {"time_s", "EGT_C", "FF_kgph", "TAT_C", "CAS_kt", "TAS_kt"},
        ),
        ("flights/jetcat_p300_20230109_120101.csv.gz", [], {"N1_pct"}),
    ],
)
def test_the_headers_of_other_recorders_map_or_ask(file, engines, open_):
    if not (DATA / file).is_file():
        pytest.skip("the measured flights are not here")
    found = draft([DATA / file])
    assert list(found.engines) == engines
    assert {line.channel for line in found.lines if OPEN in line.keys.values()} == open_
