"""Figures become small, private, repeatable SVG, and thinning never hides a peak."""

from __future__ import annotations

import re
import threading
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.report import style
from eval.report.style import MAX_POINTS, envelope, picture, spans

values_of = st.lists(
    st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=400
)


def wave(frequency: float = 1.0):
    figure = style.figure(4.0, 2.0)
    axes = figure.subplots()
    axes.plot(np.linspace(0, 1, 50), np.sin(frequency * np.arange(50)), label="a")
    axes.set_ylabel("0.12345")
    style.legend(axes)
    style.dress(axes)
    return figure


@given(values=values_of, points=st.integers(4, 60))
def test_a_thinned_curve_keeps_the_extremes_and_is_short_enough(values, points):
    values = np.array(values)
    time = np.arange(len(values), dtype=float)
    thin_time, thin = envelope(time, values, points)
    assert len(thin) <= max(points, 2)
    assert np.all(np.diff(thin_time) > 0)
    assert np.array_equal(thin, values[thin_time.astype(int)], equal_nan=True)
    if np.isfinite(values).any():
        assert np.nanmax(thin) == np.nanmax(values)
        assert np.nanmin(thin) == np.nanmin(values)


def test_a_single_spike_in_80_minutes_survives_thinning():
    values = np.zeros(80 * 60 * 32)
    values[77_777] = 5.0
    thin_time, thin = envelope(np.arange(len(values), dtype=float), values)
    assert (thin.max(), thin_time[thin.argmax()]) == (5.0, 77_777)
    assert len(thin) <= MAX_POINTS
    assert envelope(thin_time, thin)[0] is thin_time  # short enough already


def test_a_gap_longer_than_a_bin_stays_a_gap():
    values = np.ones(100_000)
    values[40_000:50_000] = np.nan
    thin_time, thin = envelope(np.arange(100_000.0), values)
    inside = (thin_time >= 40_200) & (thin_time < 49_800)
    assert inside.any()
    assert np.isnan(thin[inside]).all()


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ([], []),
        ([0, 0, 0], []),
        ([1, 1, 1], [(0.0, 2.0)]),
        ([0, 1, 0], [(1.0, 2.0)]),
        ([1, 0, 1], [(0.0, 1.0), (2.0, 2.0)]),
    ],
)
def test_spans_are_the_runs_of_flagged_samples(flags, expected):
    flagged = np.array(flags, dtype=bool)
    assert spans(np.arange(len(flags), dtype=float), flagged) == expected


def test_the_svg_is_well_formed_and_described_and_carries_no_style_sheet():
    svg = str(picture(wave(), 'N1 < "N2"').svg)
    root = ET.fromstring(svg)  # noqa: S314 - our own text
    assert root.attrib["aria-label"] == 'N1 < "N2"'
    assert root.attrib["role"] == "img"
    assert "<style" not in svg
    assert "font-family" not in svg


def test_ids_of_two_figures_never_meet_and_every_reference_resolves():
    ids = []
    for frequency in (1.0, 2.0):
        svg = str(picture(wave(frequency), "a").svg)
        own = re.findall(r' id="([^"]+)"', svg)
        assert len(own) == len(set(own))
        assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg)) == set(own)
        ids += own
    assert len(ids) == len(set(ids))


def test_rounding_touches_coordinates_but_no_text():
    svg = str(picture(wave(), "a").svg)
    assert ">0.12345<" in svg
    paths = re.findall(r' d="([^"]*)"', svg)
    assert not any(re.search(r"\.\d{3}", path) for path in paths)


def test_threads_may_draw_at_the_same_time():
    alone = picture(wave(), "a").svg
    drawn: list[str] = []
    threads = [
        threading.Thread(target=lambda: drawn.append(picture(wave(), "a").svg)) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert drawn == [alone] * 4


@pytest.mark.parametrize(
    ("channel", "label"),
    [("N1_pct", "N1 [%]"), ("EGT_C", "EGT [°C]"), ("WOW", "WOW"), ("my_signal", "my_signal")],
)
def test_axes_carry_symbol_and_unit(channel, label):
    assert style.with_unit(channel) == label
