"""Column names of recorders, read word by word."""

import pytest

from data_prep.drafting.naming import read_name
from narxcal.channels import CHANNELS


@pytest.mark.parametrize(
    ("column", "channel", "template", "engine"),
    [
        ("lh_engine_fan_N1", "N1_pct", "{engine}_engine_fan_N1", "lh"),
        ("N11C", "N1_pct", "N1{engine}C", "1"),
        ("N22C", "N2_pct", "N2{engine}C", "2"),
        ("EGT1C", "EGT_C", "EGT{engine}C", "1"),
        ("N2_4", "N2_pct", "N2_{engine}", "4"),
        ("Eng1 Fuel Flow (pph)", "FF_kgph", "Eng{engine} Fuel Flow (pph)", "1"),
        ("N1 Engine 2", "N1_pct", "N1 Engine {engine}", "2"),
        ("LEFT ENGINE N1 TACH", "N1_pct", "{engine} ENGINE N1 TACH", "LEFT"),
        ("N1 [L]", "N1_pct", "N1 [{engine}]", "L"),
        ("N1", "N1_pct", "N1", ""),
        ("Dadc1_alt", "ALT_ft", "Dadc1_alt", ""),
        ("ALT_STDC", "ALT_ft", "ALT_STDC", ""),
        ("Altitude Press", "ALT_ft", "Altitude Press", ""),
        ("fuelFlow", "FF_kgph", "fuelFlow", ""),
        ("Throttle Lever Angle R", "TRA_deg", "Throttle Lever Angle {engine}", "R"),
    ],
)
def test_a_name_gives_channel_and_engine(column, channel, template, engine):
    found = read_name(column)
    assert found is not None
    assert (found.channel, found.template, found.engine) == (channel, template, engine)
    assert not found.command


@pytest.mark.parametrize(
    "column",
    ["Altitude Radio", "Fuel Used", "Fuel Qty", "N1C", "N1T", "N1C_1", "N1 corrected", "ALTR",
     "lh_engine_FU", "Vertical Speed", "EGT limit", ""],
)  # fmt: skip
def test_a_name_with_a_word_that_is_not_known_is_no_channel(column):
    assert read_name(column) is None


@pytest.mark.parametrize(
    ("column", "unit"),
    [("egt_C", "c"), ("N1_pct", "pct"), ("rpm", "rpm"), ("N1_rpm", "rpm"), ("FF_lb_hr", "lb/hr"),
     ("time_s", "s"), ("elapsed_sec", "sec"), ("N1_1", "")],
)  # fmt: skip
def test_a_name_may_end_with_a_unit(column, unit):
    assert read_name(column).unit == unit


def test_a_demanded_speed_is_no_measured_one():
    assert read_name("rpm_setpoint").command
    assert read_name("N1 command").command


@pytest.mark.parametrize("name", CHANNELS)
def test_a_canonical_name_is_read_as_itself(name):
    assert read_name(name)[:2] == (name, name)


@pytest.mark.parametrize(
    ("column", "unit", "channel"),
    [
        ("N [rpm]", "rpm", "N1_pct"),
        ("Engine 2 speed", "1/min", "N1_pct"),
        ("Pamb", "kPa", "ALT_ft"),
        ("P_amb [mbar]", "mbar", "ALT_ft"),
        ("Barometric pressure", "inHg", "ALT_ft"),
    ],
)
def test_a_unit_settles_what_a_name_leaves_open(column, unit, channel):
    assert read_name(column) is None
    assert read_name(column, unit).channel == channel


@pytest.mark.parametrize(
    ("column", "unit"),
    [("N", "N"), ("GndSpeed", "kt"), ("Prop speed", "rpm"), ("P3", "kPa"), ("Oil pressure", "psi"),
     ("Test P", "bar"), ("Ambient", "degC")],
)  # fmt: skip
def test_a_unit_settles_no_other_name(column, unit):
    assert read_name(column, unit) is None
