"""A simulator is what the user names, and what is none is refused in a sentence."""

import sys
import zipfile

import numpy as np
import pytest

from eval.diagnosis.simulators import open_simulator
from narxcal.support.errors import ConfigError, DataError, ModelError
from tests.narxcal import fmu_source

OWN = """\
def double(inputs, dt_s):
    return {"N1_pct": 2.0 * inputs["TRA_deg"] + dt_s}

def short(inputs, dt_s):
    return {"N1_pct": inputs["TRA_deg"][1:]}

def broken(inputs, dt_s):
    return {"N1_pct": inputs["power"]}

def text(inputs, dt_s):
    return {"N1_pct": ["fast"] * len(inputs["TRA_deg"])}

def divides(inputs, dt_s):
    return {"N1_pct": inputs["TRA_deg"] * (1 / 0)}

def leaves(inputs, dt_s):
    raise SystemExit(0)

def talks(inputs, dt_s):
    print("iteration 1")
    return {"N1_pct": inputs["TRA_deg"]}

def spoils(inputs, dt_s):
    inputs["TRA_deg"] *= 0.5
    return {"N1_pct": inputs["TRA_deg"]}

number = 3
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of a user's own modules; the import path is left as it was."""
    (tmp_path / "own_engine.py").write_text(OWN, "utf-8")
    monkeypatch.chdir(tmp_path)
    before, known = list(sys.path), set(sys.modules)
    yield tmp_path
    assert sys.path == before
    for name in {file.stem for file in tmp_path.rglob("*.py")} - known:
        sys.modules.pop(name, None)


def test_a_function_beside_the_user_is_called_with_inputs_and_interval(here, fly, log_of):
    found = open_simulator("own_engine:double")
    assert found.kind == "function"
    log = log_of(fly(0, 10.0))
    np.testing.assert_allclose(found.how(log)["N1_pct"], 2.0 * log["TRA_deg"] + log.dt_s)


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("own_engine:number", "no function 'number'"),
        ("narxcal.turbofan:nothing", "no function 'nothing'"),
        ("no_engine:f", "there is no module 'no_engine'"),
        ("business_yet", "is no folder of logs, run folder, FMU, module:function or virtual"),
        ("none.fmu", "is no folder of logs, run folder, FMU"),
        (":f", "is no folder of logs, run folder, FMU"),
        ("own_engine:", "is no folder of logs, run folder, FMU"),
        ("", "is no folder of logs, run folder, FMU"),
    ],
)
def test_what_is_no_simulator_is_refused(here, source, problem):
    with pytest.raises(ConfigError, match=problem):
        open_simulator(source)


def test_a_function_that_fails_is_named(here, fly, log_of):
    log = log_of(fly(0, 10.0))
    with pytest.raises(
        ModelError, match=r"'own_engine:short' returned \(159,\), expected \(160,\)"
    ):
        open_simulator("own_engine:short").how(log)
    with pytest.raises(ModelError, match=r"'own_engine:broken' failed: KeyError: 'power'"):
        open_simulator("own_engine:broken").how(log)
    with pytest.raises(ModelError, match=r"'own_engine:text' failed: ValueError: could not conv"):
        open_simulator("own_engine:text").how(log)
    with pytest.raises(ModelError, match=r"'own_engine:divides' failed: ZeroDivisionError"):
        open_simulator("own_engine:divides").how(log)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("def f(:", "halves.py: the module cannot be imported: SyntaxError"),
        ("raise RuntimeError('no licence')", "cannot be imported: RuntimeError: no licence"),
    ],
)
def test_a_module_that_cannot_be_imported_is_named(here, text, problem):
    (here / "halves.py").write_text(text, "utf-8")
    with pytest.raises(ConfigError, match=problem):
        open_simulator("halves:f")


def test_a_module_that_needs_another_one_is_told_where_to_get_it(here):
    (here / "halves.py").write_text("import nowhere_at_all", "utf-8")
    with pytest.raises(ConfigError) as caught:
        open_simulator("halves:f")
    assert str(caught.value) == (
        f"{here}/halves.py: the module cannot be imported: ModuleNotFoundError: "
        f"No module named 'nowhere_at_all'. Install it, or put it into {here}"
    )


DECK = """\
from __future__ import annotations
from dataclasses import dataclass
from deck_tables import GAIN

@dataclass
class Deck:
    gain: float

def run(inputs, dt_s):
    from deck_later import ADDED
    return {"N1_pct": Deck(GAIN).gain * inputs["TRA_deg"] + ADDED}
"""


def test_a_simulator_of_several_files_is_one_as_python_knows_it(here, fly, log_of):
    (here / "deck.py").write_text(DECK, "utf-8")
    (here / "deck_tables.py").write_text("GAIN = 2.0", "utf-8")
    (here / "deck_later.py").write_text("ADDED = 1.0", "utf-8")
    log = log_of(fly(0, 4.0))
    found = open_simulator("deck:run").how(log)
    np.testing.assert_array_equal(found["N1_pct"], 2.0 * log["TRA_deg"] + 1.0)


def test_an_exit_in_a_users_function_is_its_failure_and_not_our_end(here, fly, log_of):
    with pytest.raises(ModelError) as caught:
        open_simulator("own_engine:leaves").how(log_of(fly(0, 4.0)))
    assert str(caught.value) == (
        "flight: simulator 'own_engine:leaves' failed: SystemExit: 0. "
        "It takes ({channel: (time,)}, dt_s) and returns {channel: (time,)}"
    )
    (here / "halves.py").write_text("import sys\nsys.exit('no licence')", "utf-8")
    with pytest.raises(ConfigError) as caught:
        open_simulator("halves:f")
    assert str(caught.value) == (
        f"{here}/halves.py: the module cannot be imported: SystemExit: no licence"
    )


def test_what_a_users_function_prints_is_not_on_stdout(here, fly, log_of, capsys):
    (here / "loud.py").write_text(f"print('hello')\n{OWN}", "utf-8")
    open_simulator("loud:talks").how(log_of(fly(0, 4.0)))
    assert capsys.readouterr() == ("", "hello\niteration 1\n")


def test_a_function_that_writes_into_its_inputs_changes_no_log(here, fly, log_of):
    log, again = log_of(fly(0, 4.0)), log_of(fly(0, 4.0))
    found = open_simulator("own_engine:spoils").how(log)
    np.testing.assert_array_equal(log["TRA_deg"], again["TRA_deg"])
    np.testing.assert_array_equal(found["N1_pct"], 0.5 * again["TRA_deg"])


def test_a_file_that_is_no_fmu_is_named(tmp_path):
    pytest.importorskip("fmpy", reason="FMUs need the extra `fmu`")
    file = tmp_path / "engine.fmu"
    file.write_text("no archive", "utf-8")
    with pytest.raises(ModelError, match=r"engine\.fmu: the file is no FMU"):
        open_simulator(str(file))


@pytest.mark.parametrize(
    ("other", "problem"),
    [
        ({"N1_pct": "fan_speed"}, "no output of the FMU is one of N1_pct, .* are fan_speed, ITT"),
        ({"TRA_deg": "lever"}, "no input of the FMU is one of TRA_deg, FF_kgph. Its inputs are le"),
    ],
)
def test_an_fmu_of_other_names_is_refused_with_those_it_has(tmp_path, other, problem):
    pytest.importorskip("fmpy", reason="FMUs need the extra `fmu`")
    file = fmu_source.build(tmp_path / "engine.fmu", 2)
    renamed = tmp_path / "renamed.fmu"
    with zipfile.ZipFile(file) as old, zipfile.ZipFile(renamed, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "modelDescription.xml":
                for before, after in other.items():
                    data = data.replace(before.encode(), after.encode())
            new.writestr(name, data)
    with pytest.raises(ModelError, match=problem):
        open_simulator(str(renamed))


def test_a_folder_of_logs_is_that_folder(tmp_path):
    assert open_simulator(str(tmp_path)) == ("logs", tmp_path, None)


def test_a_virtual_engine_flies_the_inputs(fly, log_of):
    log = log_of(fly(0, 4.0))
    switches = dict.fromkeys(("WOW", "Approach", "ECS", "WAI"), np.zeros(len(log)))
    outputs = open_simulator("business_jet").how(log.with_channels(switches))
    assert {"N1_pct", "N2_pct", "EGT_C", "FF_kgph"} <= set(outputs)
    assert outputs["N1_pct"].shape == (len(log),)


def test_a_virtual_engine_needs_its_inputs(fly, log_of):
    with pytest.raises(DataError, match="channel WOW"):
        open_simulator("business_jet").how(log_of(fly(0, 4.0)))


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_runs_through_the_whole_log(tmp_path, fly, log_of, version):
    pytest.importorskip("fmpy", reason="FMUs need the extra `fmu`")
    file = fmu_source.build(tmp_path / "engine.fmu", version)
    log = log_of(fly(0, 60.0))
    found = open_simulator(str(file))
    assert found.kind == "FMU"
    n1 = found.how(log)["N1_pct"]
    # The tests' FMU in C: N1 follows 20 + 0.9 TRA - 5 Mach with a lag of 0.1 s.
    target, state = 20.0 + 0.9 * log["TRA_deg"] - 5.0 * log["Mach"], 0.0
    expected = []
    for k in range(len(log)):
        expected.append(state)
        state += (target[k] - state) * (1.0 - np.exp(-log.dt_s / 0.1))
    np.testing.assert_allclose(n1[20:], np.array(expected)[20:], atol=1.0)


def test_an_fmu_that_fails_is_named(tmp_path, fly, log_of):
    pytest.importorskip("fmpy", reason="FMUs need the extra `fmu`")
    file = fmu_source.build(tmp_path / "engine.fmu", 2)
    log = log_of(fly(0, 10.0))
    fast = log.with_channels({"Mach": np.full(len(log), 0.95)})  # which this FMU refuses
    with pytest.raises(ModelError, match=r"engine\.fmu: the FMU failed"):
        open_simulator(str(file)).how(fast)
