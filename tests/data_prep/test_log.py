"""A log says what it is in one line."""

import numpy as np

from data_prep.log import Log


def test_its_text_tells_length_rate_and_channels_but_no_samples():
    log = Log("a.csv:left", np.arange(40) / 8, {"N1_pct": np.zeros(40), "EGT_C": np.zeros(40)})
    assert repr(log) == "<Log a.csv:left: 40 samples every 0.125 s of N1_pct, EGT_C>"
    assert repr(log.part(3, 4)) == "<Log a.csv:left: 1 samples of N1_pct, EGT_C>"


def test_its_frame_has_the_channels_over_time():
    log = Log("a.csv", np.arange(3) / 8, {"N1_pct": np.array([80.0, np.nan, 81.0])})
    frame = log.to_frame()
    assert frame.index.name == "time_s"
    np.testing.assert_array_equal(frame.index, log.time_s)
    np.testing.assert_array_equal(frame["N1_pct"], log["N1_pct"])
