"""Every kind of bad input to `narxcal diagnose`: one clear line, or an answer that says so."""

import json

import numpy as np
import pytest


@pytest.fixture
def flights(slow_probe, tmp_path):
    """Write flights, changed by `change(number, real, sim)` before they are."""

    def write(change=None, count=3, **how):
        for number in range(count):
            real, sim = slow_probe(number, **how)
            if change is not None:
                real, sim = change(number, real, sim)
            for name, table in (("real", real), ("sim", sim)):
                (tmp_path / name).mkdir(exist_ok=True)
                if table is not None:
                    table.to_csv(tmp_path / name / f"f{number}.csv", index=False)
        return ("--real", tmp_path / "real", "--sim", tmp_path / "sim")

    return write


@pytest.fixture
def refused(narxcal, tmp_path):
    """Diagnose; the one line on stderr, the folder's own name left out."""

    def run(words, *more):
        done = narxcal("diagnose", *words, *more, "--out", tmp_path / "gap")
        assert (done.code, done.out) == (2, "")
        assert not (tmp_path / "gap").exists()
        assert done.err.count("\n") == 1
        return done.err.strip().replace(f"{tmp_path}/", "")

    return run


def of_one(number, **changed):
    """A change of the recorded table of one flight by `real=`, of its simulated one by `sim=`."""

    def change(at, real, sim):
        if at != number:
            return real, sim
        how_real, how_sim = changed.get("real"), changed.get("sim")
        return how_real(real) if how_real else real, how_sim(sim) if how_sim else sim

    return change


CASES = {
    "unpaired": (
        of_one(1, sim=lambda _: None),
        (
            "sim: 'f1' has no partner here (1 of 3 logs have none). Recorded and simulated logs "
            "are paired by their file names"
        ),
    ),
    "unpaired the other way": (
        of_one(2, real=lambda _: None),
        (
            "real: 'f2' has no partner here (1 of 3 logs have none). Recorded and simulated logs "
            "are paired by their file names"
        ),
    ),
    "other inputs": (
        of_one(1, sim=lambda table: table.assign(ALT_ft=table["ALT_ft"] + 500.0)),
        (
            "f1, channel ALT_ft, row 1: the inputs differ: recorded 5000, simulated with 5500 (800 "
            "of 800 samples differ by more than rounding). Simulate with the inputs that were "
            "recorded"
        ),
    ),
    "other rates": (
        of_one(1, sim=lambda table: table.iloc[::2]),
        "f1: the rates differ: recorded at 8 Hz, simulated at 4 Hz. Put both on one raster first",
    ),
    "other lengths": (
        of_one(1, sim=lambda table: table.iloc[:-40]),
        (
            "f1: the lengths differ: recorded 800 samples, simulated 760, which is 5 s. Up to 2 s "
            "are cut at the end; simulate the whole flight"
        ),
    ),
    "rates of flights": (
        lambda at, real, sim: (real.iloc[::2], sim.iloc[::2]) if at == 2 else (real, sim),
        "f2: recorded at 4 Hz, but f0 at 8 Hz. Put all flights on one raster",
    ),
    "too little excitation": (
        lambda _, real, sim: (real.iloc[:150], sim.iloc[:150]),
        (
            "too little excitation: 3 pushes and 0 pulls of TRA_deg in 3 flights, 3 of each are "
            "needed. Fly at least 3 more pulls, idle to high power and back"
        ),
    ),
    "a constant recorded channel": (
        of_one(1, real=lambda table: table.assign(EGT_C=500.0)),
        (
            "f1, channel EGT_C: the recorded channel is constant (500 throughout). Its sensor is "
            "stuck, or another column is meant; leave the channel or log out"
        ),
    ),
    "a constant simulated channel": (
        of_one(1, sim=lambda table: table.assign(N1_pct=50.0)),
        (
            "f1, channel N1_pct: the simulated channel is constant (50 throughout). Its sensor is "
            "stuck, or another column is meant; leave the channel or log out"
        ),
    ),
    "nothing recorded": (
        of_one(1, real=lambda table: table.assign(EGT_C=np.nan)),
        (
            "f1, channel EGT_C: no recorded sample is known. Leave the channel out of all logs, or "
            "this log out"
        ),
    ),
    "simulated with holes": (
        of_one(1, sim=lambda table: table.assign(N1_pct=table["N1_pct"].where(table.index < 99))),
        (
            "f1, channel N1_pct: 701 of 800 simulated samples are missing. Simulate the whole "
            "flight, or leave the log or the channel out"
        ),
    ),
    "no speed": (
        lambda _, real, sim: (real, sim.drop(columns=["N1_pct", "N2_pct"])),
        (
            "f0: recorded and simulated log share neither N1_pct nor N2_pct. A spool speed has to "
            "be on both sides; recorded are N1_pct, N2_pct, EGT_C, simulated are EGT_C"
        ),
    ),
    "no driver": (
        lambda _, real, sim: (real.drop(columns="TRA_deg"), sim.drop(columns="TRA_deg")),
        (
            "f0: there is no TRA_deg, and no FF_kgph to take for the driver. Map the throttle's "
            "column, or the fuel flow's"
        ),
    ),
    "no time": (
        of_one(1, real=lambda table: table.drop(columns="time_s")),
        (
            "real/f1.csv: column 'time_s' is missing. The file has TRA_deg, ALT_ft, N1_pct, "
            "N2_pct, EGT_C. Or map the columns under [logs.columns]"
        ),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_cannot_be_diagnosed_is_one_line(flights, refused, name):
    change, problem = CASES[name]
    assert refused(flights(change)) == f"narxcal: error: {problem}"


def test_held_out_flights_are_checked_before_any_work(flights, slow_probe, refused, tmp_path):
    words = flights()
    late = [("--heldout-real", tmp_path / "late"), ("--heldout-sim", tmp_path / "late_sim")]
    for _, folder in late:
        folder.mkdir()
    real, sim = slow_probe(9)
    real.iloc[::3].to_csv(tmp_path / "late" / "f9.csv", index=False)
    sim.iloc[::3].to_csv(tmp_path / "late_sim" / "f9.csv", index=False)
    assert refused(words, *late[0], *late[1]) == (
        "narxcal: error: f9: the held-out flights are processed at 2.667 Hz, those of the "
        "diagnosis at 4 Hz. Record and simulate them with the channels and at the rate of the "
        "others"
    )
    again = ("--heldout-real", tmp_path / "real", "--heldout-sim", tmp_path / "sim")
    assert refused(words, *again) == (
        "narxcal: error: f0: the held-out flight is 'f0' of the diagnosis: nothing could be "
        "checked on it. Hold flights out that are not among those of --real"
    )
    assert refused(words, *late[0]) == (
        "narxcal: error: held-out flights need their simulated logs. Name them by --heldout-sim"
    )


def answered(narxcal, words, out):
    done = narxcal("diagnose", *words, "--out", out, "--json")
    assert done.code == 0
    return json.loads(done.out), done.err


@pytest.mark.slow
def test_one_short_flight_gets_no_firm_answer(flights, narxcal, tmp_path):
    document, said = answered(narxcal, flights(count=1), tmp_path / "gap")
    assert document["verdict"]["kind"] == "unknown"
    assert document["verdict"]["effects"] == []
    assert document["verdict"]["reason"].startswith("one flight of less than 10 minutes is no")
    assert said == "narxcal: warning: 1 flight: the uncertainty is wider\n"
