"""An airline recorder's export is read untouched: codes are masked, and no event is invented."""

import numpy as np
import pytest

from data_prep.drafting.draft import draft
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from narxcal.atmosphere import KELVIN, isa
from narxcal.support.settings import OPEN
from tests.recorder import CODED, ENGINE, ROWS_HZ, write_export

SAMPLES = 4  # by which an event may begin elsewhere: one sample of a lever at 4 Hz is missing


@pytest.fixture(scope="module")
def export(tmp_path_factory, piece):
    """Export with faults, its twin without, and what was put into the former."""
    engines = []
    for seed in (1, 2):
        channels = piece(seed, 300.0, ROWS_HZ).recorded
        sat = isa(channels["ALT_ft"])[0] - KELVIN + channels["dT_C"]
        engines.append({**channels, "SAT_C": sat})
    folder = tmp_path_factory.mktemp("export")
    rng = np.random.default_rng(5)
    put = write_export(folder / "flight.csv", engines, rng, faults=True)
    write_export(folder / "twin.csv", engines, rng, faults=False)
    return folder, put


def test_its_header_settles_every_column(export):
    found = draft([export[0] / "flight.csv"])
    assert not [line for line in found.lines if OPEN in line.keys.values()]
    assert found.engines == {"engine1": "1", "engine2": "2"}
    assert found.unused == {}


def test_every_code_word_is_masked_and_every_mark_counted_and_nothing_else(export):
    folder, put = export
    config = draft([folder / "flight.csv"]).logs()
    logs = read_logs(folder / "flight.csv", config)
    for number, log in enumerate(logs, 1):
        counted = {}
        for entry in log.audit.entries:
            if entry.action == "dropped":
                kind = "word" if entry.reason.startswith("code word") else entry.reason
                counted[entry.channel, kind] = entry.samples
        for name, word in ENGINE.items():
            ones, stars = put[word.name.format(number)]
            assert counted.get((name, "no value: *"), 0) == stars
            assert counted.get((name, "word"), 0) == ones
            assert (ones > 0) == (name in CODED)
        assert counted["*", "row of units"] == 1
        assert counted["*", "row of types or codes below the header"] == 1


def test_no_event_is_invented_and_none_is_lost(export):
    folder, _ = export
    config = draft([folder / "twin.csv"]).logs()
    found, known = (
        [one.events for one in prepare(read_logs(folder / f"{name}.csv", config))]
        for name in ("flight", "twin")
    )
    for events, true in zip(found, known, strict=True):
        assert len(true) > 5
        assert [event.label for event in events] == [event.label for event in true]
        away = [a.start - b.start for a, b in zip(events, true, strict=True)]
        assert np.abs(away).max() <= SAMPLES
