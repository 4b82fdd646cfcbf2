"""`narxcal init`: from a header that nobody mapped to a configuration that runs."""

import json
import tomllib

import numpy as np
import pytest

from narxcal.support.settings import in_toml

TIME_S = np.arange(1200) / 10.0
SPEED_PCT = 70.0 + 25.0 * np.sin(TIME_S / 9.0)


@pytest.fixture
def logs(tmp_path):
    paths = [tmp_path / f"day_{number}.csv" for number in (1, 2, 3)]
    for path in paths:
        np.savetxt(
            path,
            np.column_stack([TIME_S, SPEED_PCT / 2.0, SPEED_PCT, 20.0 * SPEED_PCT]),
            fmt="%.6g", delimiter=",", header="t [s],TLA [deg],N1 [%],FF", comments="",
        )  # fmt: skip
    return paths


def test_what_is_open_is_named_and_refused_until_it_is_filled_in(logs, narxcal, tmp_path):
    out = tmp_path / "mine.toml"
    done = narxcal("init", *logs, "--out", out)
    assert (done.code, done.err) == (0, "")
    asked = 'FF_kgph = { column = "FF", unit = "?" }  # kg/h or lb/h? It is 900 to 1900'
    assert f"To be filled in: {asked}\n" in done.out
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")

    done = narxcal("prepare", out, "--out", tmp_path / "prepared")
    text = out.read_text("utf-8")
    line = 1 + text.splitlines().index(asked)
    assert done.code == 2
    assert done.err == (
        f"narxcal: error: {out}: line {line}: 'logs.columns.FF_kgph.unit' is still to be filled "
        'in: kg/h or lb/h? It is 900 to 1900. Put a value in the place of "?"\n'
    )

    out.write_text(text.replace('unit = "?"', 'unit = "lb/h"'), "utf-8")
    done = narxcal("prepare", out, "--out", tmp_path / "prepared", "--json")
    assert done.code == 0
    config = json.loads(done.out)["config"]
    assert config["events"]["driver"] == config["steady_state"]["inputs"][0] == "TRA_deg"
    assert config["narx"]["outputs"] == ["N1_pct"]
    assert config["split"]["train"] == ["day_1.csv*", "day_2.csv*"]
    assert config["split"]["test"] == ["day_3.csv*"]


def test_columns_that_say_nothing_are_named(logs, narxcal, tmp_path):
    path, names = tmp_path / "more.csv", [f"x{number} [V]" for number in range(30)]
    table = np.column_stack([TIME_S, SPEED_PCT / 2.0, SPEED_PCT, *30 * [TIME_S]])
    header = ",".join(["t [s],TLA [deg],N1 [%]", *names])
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header=header, comments="")
    done = narxcal("init", path, "--out", tmp_path / "mine.toml")
    text = (tmp_path / "mine.toml").read_text("utf-8")
    assert 'No column is known as ALT_ft, Mach, dT_C. Not known: "x0 [V]", ' in done.out
    twenty = ", ".join(json.dumps(name) for name in names[:20])
    assert f"# not known, give one to a channel to use it: {twenty}, and 10 more\n" in text
    assert "no column is known as ALT_ft, Mach, dT_C: the model knows none\n" in text
    done = narxcal("init", *logs, "--out", tmp_path / "other.toml")
    assert "Not known" not in done.out
    assert "not known" not in (tmp_path / "other.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("header", "driver", "outputs"),
    [
        ("time,Fuel Flow [kg/h],Torque [Nm],Prop Speed [rpm]", "FF_kgph",
         ["Torque_Nm", "PropSpeed_rpm"]),
        ("time,Power Lever Position [%],Propeller Speed [rpm],Rail Pressure [bar]", "TRA_deg",
         ["PropellerSpeed_rpm"]),
        ("time,TLA,Fuel Flow [kg/h],x", "TRA_deg", ["FF_kgph"]),
        ("a,b,c,d", "?", ["?"]),
    ],
)  # fmt: skip
def test_any_file_of_numbers_gives_a_draft(narxcal, tmp_path, header, driver, outputs):
    """Where no speed or temperature is known, what is declared is modelled; `$` is no formula."""
    path, out = tmp_path / "a$_{b$.csv", tmp_path / "mine.toml"
    table = np.column_stack([TIME_S, SPEED_PCT / 2.0, 9.0 * SPEED_PCT, 5.0 * SPEED_PCT])
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header=header, comments="")
    done = narxcal("init", path, "--out", out)
    assert (done.code, done.err) == (0, "")
    found = tomllib.loads(out.read_text("utf-8"))
    assert (found["events"]["driver"], found["narx"]["outputs"]) == (driver, outputs)
    own = {name for name in outputs if name.endswith(("_Nm", "_rpm"))}
    assert {*found["logs"].get("channels", {})} == own <= {*found["logs"]["columns"]}
    done = narxcal("prepare", out, "--out", tmp_path / "prepared")
    assert ("is still to be filled in" in done.err) == ('"?"' in out.read_text("utf-8"))


def test_logs_with_true_airspeed_and_total_temperature_give_what_prepare_takes(narxcal, tmp_path):
    """Mach by both, the temperature and the speed of weight on wheels by Mach."""
    path, out = tmp_path / "air.csv", tmp_path / "mine.toml"
    table = np.column_stack([TIME_S, SPEED_PCT / 2.0, SPEED_PCT, 90.0 * SPEED_PCT, 3.0 * SPEED_PCT])
    header = "t [s],TLA [deg],N1 [%],Alt [ft],TAS [kt],TAT [degC]"
    table = np.column_stack([table, 0.1 * SPEED_PCT])
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header=header, comments="")
    narxcal("init", path, "--out", out)
    found = tomllib.loads(out.read_text("utf-8"))
    assert found["steady_state"]["inputs"] == ["TRA_deg", "ALT_ft", "Mach", "dT_C"]
    assert found["logs"]["derive"]["WOW"]["airspeed"] == "CAS_kt"
    assert narxcal("prepare", out, "--out", tmp_path / "prepared").code == 0


def test_rows_that_share_stamps_may_be_of_several_engines_which_is_asked(narxcal, tmp_path):
    path, out = tmp_path / "both.csv", tmp_path / "mine.toml"
    both = np.column_stack([TIME_S, 0 * TIME_S, SPEED_PCT / 2.0, SPEED_PCT])
    other = both + np.array([0.0, 1.0, 0.0, -2.0])
    table = np.stack([both, other], axis=1).reshape(-1, 4)
    np.savetxt(path, table, "%.6g", ",", header="t [s],Engine,TLA [deg],N1 [%]", comments="")
    done = narxcal("init", path, "--out", out)
    assert 'To be filled in: instances = ["?"]  # rows share their time stamps: ' in done.out
    out.write_text(out.read_text("utf-8").replace('["?"]', '["Engine"]'), "utf-8")
    done = narxcal("prepare", out, "--out", tmp_path / "prepared", "--json")
    assert [each["log"] for each in json.loads(done.out)["logs"]] == ["both.csv:0", "both.csv:1"]


def test_a_configuration_that_is_there_is_not_replaced(logs, narxcal, tmp_path):
    (tmp_path / "mine.toml").write_text("mine", "utf-8")
    done = narxcal("init", *logs, "--out", tmp_path / "mine.toml")
    assert done.code == 2
    assert "mine.toml exists" in done.err
    assert (tmp_path / "mine.toml").read_text("utf-8") == "mine"


@pytest.mark.parametrize("value", ['N1 "raw" [%] \\ \x7f\t°', True, -2.5, ["a", "b\n"]])
def test_values_read_back_as_they_were_written(value):
    assert tomllib.loads(f"x = {in_toml(value)}")["x"] == value
