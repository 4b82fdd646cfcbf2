"""The demonstration, and ways to spoil the flights that it passes: none of them passes.

More ways, of an exact engine: tests/attack/test_pass.py.
"""

import json

import numpy as np
import pandas as pd
import pytest

from data_prep.prepare import prepare
from data_prep.reading import read_logs
from eval.judging.evaluate import evaluate
from eval.run_logs import run_config
from narxcal import NarxcalError, load_bundle
from narxcal.cli.app import main
from tests.golden.test_golden import lost

pytestmark = pytest.mark.slow
RATE_HZ = 32


@pytest.fixture(scope="module")
def demonstration(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "run"
    assert main(["demo", "--out", str(out), "--quiet"]) == 0
    return out


def test_the_demonstration_needs_no_files_and_ends_with_a_page(demonstration):
    assert json.loads((demonstration / "demo.json").read_text("utf-8"))["complete"] is True
    assert (demonstration / "evaluate" / "evaluate.html").is_file()
    documents = {
        file.relative_to(demonstration).as_posix(): json.loads(file.read_text("utf-8"))
        for file in demonstration.rglob("*.json")
    }
    assert lost("of_demo", documents.items()) == []


def share(t):
    """Share of the flight that is over."""
    return (t - t[0]) / np.ptp(t)


def late(v, seconds):
    return np.concatenate([np.full(seconds * RATE_HZ, v[0]), v[: -seconds * RATE_HZ]])


def noise(size):
    return lambda v, _: v + np.random.default_rng(0).normal(0.0, size, len(v))


CHANGED = {  # channel, function of its values and of time
    "N1 lost at the end": ("N1_pct", lambda v, t: np.where(share(t) > 0.67, np.nan, v)),
    "N1 in pieces": ("N1_pct", lambda v, t: np.where(t % 4.0 < 2.0, np.nan, v)),
    "N1 too high": ("N1_pct", lambda v, _: v + 2.0),
    "N2 halved": ("N2_pct", lambda v, _: 0.5 * v),
    "N2 steps": ("N2_pct", lambda v, t: v + 1.5 * (share(t) > 0.5)),
    "EGT negative": ("EGT_C", lambda v, _: -v),
    "EGT constant": ("EGT_C", lambda v, _: np.full(len(v), 600.0)),
    "EGT constant with noise": ("EGT_C", lambda v, t: noise(1.0)(np.full(len(v), 600.0), t)),
    "EGT gain": ("EGT_C", lambda v, _: 1.2 * v),
    "EGT kelvin": ("EGT_C", lambda v, _: v + 273.15),
    "EGT degF": ("EGT_C", lambda v, _: 1.8 * v + 32.0),
    "EGT late": ("EGT_C", lambda v, _: late(v, 3)),
    "EGT clipped": ("EGT_C", lambda v, _: np.minimum(v, np.quantile(v, 0.7))),
    "EGT too high": ("EGT_C", lambda v, _: v + 25.0),
    "WOW stuck at 0": ("WOW", lambda v, _: 0.0 * v),
    "WOW stuck at 1": ("WOW", lambda v, _: 0.0 * v + 1.0),
    "lever off": ("TRA_deg", lambda v, _: v + 5.0),
    "lever gain": ("TRA_deg", lambda v, _: 0.9 * v),
    "altitude in m": ("ALT_ft", lambda v, _: 0.3048 * v),
    "altitude stuck": ("ALT_ft", lambda v, _: np.full(len(v), v[0])),
    "Mach in percent": ("Mach", lambda v, _: 100.0 * v),
    "Mach stuck at 0": ("Mach", lambda v, _: 0.0 * v),
    "air 30 K warmer": ("dT_C", lambda v, _: v + 30.0),
    "anti-ice lost": ("NAI", lambda v, _: np.full(len(v), np.nan)),
    "time stretched": ("time_s", lambda v, _: 2.0 * v),
    "time halved": ("time_s", lambda v, _: 0.5 * v),
}
MADE_ANEW = {
    "half of the rows": lambda table: table[np.arange(len(table)) // 200 % 2 == 0],
    "no bleed": lambda table: table.assign(NAI=0, WAI=0, ECS=0),
    "cut before the first push": lambda table: table[: 20 * RATE_HZ],
}


def changed(table, way):
    if way == SOUND:
        return table
    if way in MADE_ANEW:
        return MADE_ANEW[way](table)
    channel, change = CHANGED[way]
    values, time_s = table[channel].to_numpy(np.float64), table["time_s"].to_numpy()
    return table.assign(**{channel: change(values, time_s)})


SOUND = "as they were flown"


@pytest.fixture(scope="module")
def bundle(demonstration):
    return load_bundle(demonstration / "run", trust=True)


@pytest.mark.parametrize("way", [SOUND, *CHANGED, *MADE_ANEW])
def test_no_way_to_an_undeserved_pass(demonstration, bundle, tmp_path, way):
    config, _ = run_config(bundle)
    (flight,) = (demonstration / "flights").glob("flight_14_*")
    file = tmp_path / "new.csv"
    changed(pd.read_csv(flight, comment="#"), way).to_csv(file, index=False)
    try:
        logs = [one.log for one in prepare(read_logs([file], config.logs), config)]
        found = evaluate(bundle, logs)
    except NarxcalError:  # refused
        return
    assert found.outcome.exit_code == (way != SOUND)
    assert found.outcome.lines or way == SOUND
