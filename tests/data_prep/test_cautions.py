"""What is said of logs before their figures."""

import numpy as np

from data_prep.cautions import cautions, crowded
from data_prep.events import EventsConfig
from data_prep.reading import read_logs

EVENTS = EventsConfig(condition="")


def written(folder, stamps):
    rows = [f"{stamp:.10g},{80 + k},30" for k, stamp in enumerate(stamps)]
    path = folder / "log.csv"
    path.write_text("\n".join(["time_s,N1_pct,TRA_deg", *rows]) + "\n", encoding="utf-8")
    return read_logs(path)[0]


def test_stamps_coarser_than_the_rows_are_told(tmp_path):
    log = written(tmp_path, np.floor(np.arange(400) / 8))
    said = (
        "log.csv: 350 rows have the time stamp of the row before and were left out; its stamps are "
        "coarser than its rows"
    )
    assert crowded(log) == said
    assert cautions([log], EVENTS) == [said]
    assert len(cautions([log], EventsConfig())) == 2


def test_a_few_equal_stamps_are_no_caution(tmp_path):
    stamps = np.arange(400) / 8
    stamps[100] = stamps[99]
    log = written(tmp_path, stamps)
    assert any(entry.reason == "duplicate time stamp" for entry in log.audit.entries)
    assert cautions([log], EVENTS) == []
