"""The page about the open flights: what one engine tells of the other, and the real thing."""

from dataclasses import replace

import numpy as np
import pytest

from eval.gap.flights_page import write_page
from eval.gap.flights_steps import FlightStudy, Judged, level, level_interval
from eval.gap.flights_study import settled, study
from narxcal.support.errors import DataError

DT_S = 0.5
SHIFT = np.array([-2.0, -1.0, 20.0])
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")


def flown(windows=((200.0, 500.0), (700.0, 900.0)), engines=2):
    """Two engines of other noise and offset that share a load in `windows`."""
    random = np.random.default_rng(3)
    time = np.arange(0.0, 1200.0, DT_S)
    on = np.zeros(len(time))
    for start, stop in windows:
        on[(time >= start) & (time < stop)] = 1.0
    fuel = np.where((time > 300.0) & (time < 1000.0), 400.0, 200.0) * np.ones((engines, 1))
    sim = np.stack([0.1 * fuel, 0.05 * fuel, fuel], axis=2)
    slow = np.cumsum(random.standard_normal((engines, len(time), 3)), axis=1) * 0.002
    white = 0.03 * random.standard_normal(slow.shape)
    real = sim + (slow + white) * np.array([1.0, 1.0, 15.0]) + on[:, None] * SHIFT
    names = ("left", "right", "third")[:engines]
    return Judged(names, OUTPUTS, DT_S, real, sim, fuel)


@pytest.fixture(scope="module")
def found():
    return study("a flight", flown())


def test_the_windows_of_one_engine_tell_the_error_of_the_other(found):
    starts = sorted({round(window.start_s) for window in found.windows.found})
    np.testing.assert_allclose(starts, [200.0, 700.0], atol=2.0)
    assert found.confirmed
    assert found.explained > 0.8
    assert (found.steps[1].rmse < 0.6 * found.steps[0].rmse).all()
    assert found.steps[1].fitted == "no"


def test_the_spans_of_the_edges_hold_them(found):
    assert {window.start_s < 450.0 for window in found.windows.found} == {True, False}
    for window in found.windows.found:
        start, stop = (200.0, 500.0) if window.start_s < 450.0 else (700.0, 900.0)
        assert window.start_span_s[0] - 1.0 <= start <= window.start_span_s[1] + 1.0
        assert window.stop_span_s[0] - 1.0 <= stop <= window.stop_span_s[1] + 1.0


def test_what_holds_no_windows_is_not_confirmed():
    silent = study("a flight", flown(windows=()))
    assert silent.windows.found == ()
    assert not silent.confirmed
    np.testing.assert_allclose(silent.steps[1].rmse, silent.steps[0].rmse)


def test_sizes_are_those_of_least_squares(found):
    judged, on = found.judged, found.windows.on[0]
    for size, expected in zip(level_interval(judged, 0, on), SHIFT, strict=True):
        assert size.low <= size.value <= size.high
        assert size.value == pytest.approx(expected, rel=0.15)
    shapes = [np.array([0.0, 1.0, 0.0, 1.0])]
    gap = np.array([[1.0], [4.0], [1.0], [np.nan]])
    np.testing.assert_allclose(level(gap, shapes), [[3.0], [1.0]])


def test_an_engine_is_unsettled_for_ten_seconds_after_its_fuel_moved():
    fuel = np.where(np.arange(200) < 100, 200.0, 400.0)[None]
    quiet = settled(fuel, DT_S)[0]
    assert quiet[:98].all()
    assert not quiet[98:120].any()
    assert quiet[121:].all()


def test_the_page_names_windows_sizes_and_errors(found, tmp_path):
    silent = replace(found, windows=replace(found.windows, found=()))
    lost = replace(found, steps=(found.steps[0], found.steps[0], *found.steps[2:]))
    write_page([found, silent, lost], tmp_path)
    page = (tmp_path / "citation_gap.md").read_text("utf-8")
    assert "**Windows: 2**" in page
    assert "Confirmed" in page
    assert "No windows" in page
    assert "**Not confirmed**" in page
    assert page.count("| as is | no |") == 4
    assert (tmp_path / "citation_gap_1.png").read_bytes()[:4] == b"\x89PNG"


def test_a_flight_needs_two_engines():
    with pytest.raises(DataError, match="expected two engines"):
        study("a flight", flown(engines=1))


def test_the_study_is_of_the_same_kind_at_every_step(found):
    assert isinstance(found, FlightStudy)
    fitted = [step.fitted for step in found.steps]
    assert fitted == ["no", "no", "windows", "windows", "yes", "yes"]
