"""Channels that a configuration declares: names, units, ranges, and what is refused."""

import re

import numpy as np
import pytest

from data_prep.cleaning.clean import clean
from data_prep.cleaning.plausibility import checked
from data_prep.config import LogsConfig
from data_prep.drafting.draft import draft
from data_prep.drafting.naming import declarable
from data_prep.log import Log
from data_prep.prepare import Preparation
from data_prep.reading import read_logs
from data_prep.sources.units import find_unit, to_canonical
from narxcal.channels import ENDINGS, described, symbol
from narxcal.support.errors import ConfigError, DataError
from tests.turboprop import HEADER, write

CHANNELS = {
    "NP_rpm": {"range": [0.0, 2200.0]},
    "TRQ_Nm": {"range": [-500.0, 9000.0], "unit": "Nm"},
    "SHP_kW": {"range": [-50.0, 1500.0]},
}
COLUMNS = {
    "time_s": {"column": HEADER["t"]},
    "N2_pct": {"column": HEADER["ng"]},
    "NP_rpm": {"column": HEADER["np"]},
    "TRQ_Nm": {"column": HEADER["torque"]},
    "SHP_kW": {"column": HEADER["power"]},
}


def test_the_end_of_a_name_is_its_unit():
    assert {described(f"X_{end}").unit for end in ENDINGS} == {*ENDINGS.values()}
    names = ("TRQ_Nm", "N1_pct", "u_1", "EPR2")
    assert [symbol(name) for name in names] == ["TRQ", "N1", "u_1", "EPR2"]
    assert [described(name).unit for name in ("EPR2", "u_1", "Nm")] == ["-", "-", "-"]


@pytest.mark.parametrize(
    ("name", "unit", "value"),
    [
        ("TRQ_Nm", "lbf.ft", 1.3558179483314),  # NIST SP 811, appendix B.8
        ("TRQ_Nm", "lbf.in", 0.1129848290276),
        ("SHP_kW", "hp", 0.7456998715823),
        ("SHP_kW", "PS", 0.73549875),
        ("P3_kPa", "psi", 6.8947572931684),
        ("P3_kPa", "bar", 100.0),
        ("NP_rpm", "1/min", 1.0),
        ("TRQ_pct", "-", 100.0),
    ],
)
def test_recorded_units_become_the_one_of_the_name(name, unit, value):
    found = to_canonical(np.array([1.0]), find_unit(unit, name))[0]
    assert found == pytest.approx(value, rel=1e-12)


def test_a_barometer_is_a_pressure_altitude():
    found = to_canonical(np.array([1013.25, 696.817]), find_unit("hPa", "ALT_ft"))
    np.testing.assert_allclose(found, [0.0, 10000.0], atol=0.2)  # ISO 2533: 696.817 hPa
    with pytest.raises(ConfigError, match="is a pressure, this channel is a temperature"):
        find_unit("hPa", "EGT_C")


def test_columns_are_read_into_declared_channels_in_their_units(tmp_path):
    flight = write(tmp_path / "flight.csv", 1, 20.0)
    config = LogsConfig.parse({"channels": CHANNELS, "columns": COLUMNS})
    (log,) = read_logs(tmp_path / "flight.csv", config)
    for name, own in (("NP_rpm", "np"), ("TRQ_Nm", "torque"), ("SHP_kW", "power")):
        np.testing.assert_allclose(log[name], flight[own], atol=1e-4)
    assert (log.channel("TRQ_Nm").low, log.channel("TRQ_Nm").high) == (-500.0, 9000.0)
    assert log.channel("N2_pct") == described("N2_pct")


def test_a_canonical_header_needs_no_columns(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time_s,N2_pct,TRQ_Nm,X_kW\n0,80,100,1\n1,81,200,1\n2,82,300,1\n", "utf-8")
    config = LogsConfig.parse({"channels": {"TRQ_Nm": {"range": [0.0, 1e4]}}})
    (log,) = read_logs(path, config)
    assert list(log.channels) == ["N2_pct", "TRQ_Nm"]


def test_samples_outside_of_the_declared_range_are_masked_and_another_unit_is_found(tmp_path):
    write(tmp_path / "flight.csv", 1, 60.0)
    config = LogsConfig.parse({"channels": CHANNELS, "columns": COLUMNS})
    (log,) = read_logs(tmp_path / "flight.csv", config)
    torque = log["TRQ_Nm"].copy()
    torque[100:150] = 20000.0
    found = clean(log.with_channels({"TRQ_Nm": torque}))
    assert found.audit.masked()["TRQ_Nm"] == {"out of range": 50}
    assert np.isnan(found["TRQ_Nm"][100:150]).all()

    low = {**CHANNELS, "SHP_kW": {"range": [0.0, 10.0]}}
    (log,) = read_logs(
        tmp_path / "flight.csv", LogsConfig.parse({"channels": low, "columns": COLUMNS})
    )
    assert clean(log).audit.masked()["SHP_kW"] == {"out of range": len(log)}
    assert not [each for each in checked(log).findings if each.channel == "TRQ_Nm"]


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        (
            {"N1_pct": {"range": [0, 100]}},
            (
                "'N1_pct', and N1_pct is built in. Map the column to N1_pct, "
                "with scale and offset, or choose another name"
            ),
        ),
        (
            {"N2_rpm": {"range": [0, 100]}},
            (
                "'N2_rpm', and N2_pct is built in. Map the column to N2_pct, "
                "with scale and offset, or choose another name"
            ),
        ),
        (
            {"TRQ_pct": {"range": [110, 0]}},
            "key 'channels.TRQ_pct.range': expected [lowest, highest], found [110, 0]",
        ),
        ({"TRQ_pct": {"unit": "%"}}, "key 'channels.TRQ_pct.range' is missing. Add it"),
        (
            {"TRQ_furlong": {"range": [0, 1], "unit": "furlong"}},
            (
                "'TRQ_furlong' in 'furlong', which is no unit of a channel. "
                "Units are %, rpm, kW, Nm, kN, kPa, degC, kg/h, deg, A, V and -. [logs.columns] "
                "converts from others"
            ),
        ),
        (
            {"TRQ": {"range": [0, 1], "unit": "Nm"}},
            ("'TRQ', a name that does not end in its unit. Name it TRQ_Nm"),
        ),
        (
            {"TRQ_ftlb": {"range": [0, 1]}},
            (
                "'TRQ_ftlb', a name that does not end in its unit. Units end in _pct, _rpm, _kW, "
                "_Nm, _kN, _kPa, _C, _kgph, _deg, _A, _V; a ratio has no '_'"
            ),
        ),
        (
            {"TRQ_Nm": {"range": [0, 1]}, "TRQ_pct": {"range": [0, 1]}},
            (
                "'TRQ' twice. Tables and pages show channels without their "
                "units: give it another name"
            ),
        ),
        (
            {"TRQ_Nm": {"range": [0, 1]}},
            (
                "'TRQ_Nm', and [logs.columns] has no column for it. Add "
                'TRQ_Nm = { column = "...", unit = "Nm" }'
            ),
        ),
    ],
)
def test_a_declaration_that_cannot_be_is_refused(channels, message):
    columns = {"time_s": {"column": "t"}, "N2_pct": {"column": "n"}}
    with pytest.raises(ConfigError) as caught:
        LogsConfig.parse({"channels": channels, "columns": columns})
    assert str(caught.value).removeprefix("[logs.channels] declares ") == message


@pytest.mark.parametrize("commanded", [False, True])
def test_a_command_may_stay_and_jump(commanded):
    time_s = np.arange(6000) / 10.0
    speed = 60.0 + 10.0 * np.sin(time_s / 7.0)
    noise = np.random.default_rng(0).normal(0.0, 0.3, len(time_s))
    fuel = 40.0 + noise + 5.0 * np.sin(time_s / 7.0)
    fuel[2000:3000] = 30.0
    declared = LogsConfig.parse(
        {"channels": {"FuelCall_pct": {"range": [0, 100], "commanded": commanded}}}
    )
    log = Log("f", time_s, {"N1_pct": speed, "FuelCall_pct": fuel}, declared=declared.declared)
    masked = clean(log).audit.masked().get("FuelCall_pct", {})
    assert sum(masked.values()) == (0 if commanded else 1000)


def test_a_name_that_nothing_declares_is_refused_wherever_it_stands():
    with pytest.raises(ConfigError) as caught:
        LogsConfig.parse({"columns": {"time_s": {"column": "t"}, "TRQ_Nm": {"column": "q"}}})
    assert re.fullmatch(
        r"unknown channel 'TRQ_Nm'\. .* Or declare it: \[logs\.channels\] TRQ_Nm = "
        r"\{ range = \[0, 100\] \}",
        str(caught.value),
    )
    declared = {"logs": {"channels": CHANNELS}, "running": {"above": {"NP_rpm": 300.0}}}
    assert Preparation.parse(declared).running.above == {"NP_rpm": 300.0}
    with pytest.raises(ConfigError, match="unknown channel 'NP_rpm'"):
        Preparation.parse({"running": declared["running"]})


def test_a_unit_of_the_file_that_does_not_fit_is_an_error(tmp_path):
    write(tmp_path / "flight.csv", 1, 5.0)
    columns = {**COLUMNS, "SHP_kW": {"column": HEADER["torque"]}}
    with pytest.raises(DataError, match=r"the header says 'ft-lb', which does not fit kW"):
        read_logs(
            tmp_path / "flight.csv", LogsConfig.parse({"channels": CHANNELS, "columns": columns})
        )


@pytest.mark.parametrize(
    ("column", "unit", "found"),
    [
        ("Torque (ft-lb)", "ft-lb", ("Torque_Nm", "Torque (ft-lb)", "lbf.ft")),
        ("ENG1 TRQ [%]", "%", ("TRQ_pct", "ENG{engine} TRQ [%]", "%")),
        ("prop_speed_rpm", "", ("PropSpeed_rpm", "prop_speed_rpm", "rpm")),
        ("SHP", "hp", ("SHP_kW", "SHP", "hp")),
        ("Oil Press", "PSI", ("OilPress_kPa", "Oil Press", "psi")),
        ("Shaft_Power_kW", "", ("ShaftPower_kW", "Shaft_Power_kW", "kW")),
        ("p_hPa", "", ("P_kPa", "p_hPa", "hPa")),
        ("GenLoadkW", "", ("GenLoad_kW", "GenLoadkW", "kW")),
        ("Heading (deg)", "deg", None),
        ("Distance", "nm", None),
        ("Torque", "", None),
        ("N2 (rpm)", "rpm", None),
        ("3rd stage (psi)", "psi", None),
    ],
)
def test_a_column_that_is_no_channel_is_offered_with_its_unit(column, unit, found):
    assert declarable(column, unit, ("1", "2")) == found


def test_a_draft_offers_columns_that_may_be_declared(tmp_path):
    write(tmp_path / "flight.csv", 1, 120.0)
    found = draft([tmp_path / "flight.csv"]).others
    assert [line.channel for line in found] == ["PropSpeed_rpm", "Torque_Nm", "ShaftPower_kW"]
    assert re.fullmatch(
        r'Torque_Nm = \{ column = "Torque \(ft-lb\)", unit = "lbf\.ft" \}  # \d+ to \d+ Nm',
        str(found[1]),
    )
