"""Drawings against closed forms, read back from the axes; pages draw by the same functions."""

import numpy as np
import pytest
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from eval.report import plot
from eval.report.event_figures import overlay_figure as event_figure
from eval.report.figures import overlay_figure
from narxcal import DataError, Narx

DECAY, GAIN = 0.8, 2.0  # y(k) = DECAY y(k-1) + (1 - DECAY) GAIN u(k-1)


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def lag(u):
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = DECAY * y[k - 1] + (1.0 - DECAY) * GAIN * u[k - 1]
    return y


class Lag:
    """What drawings ask of a `Narx`."""

    input_names_ = output_names_ = ()
    dt_s = 0.5

    def simulate(self, u, start):
        return lag(u[:, 0])[:, None] + start[0] * 0.0


def moved(seed, samples=4000):
    """An input between held levels, with some noise."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(size=samples // 20), 20) + 0.5 * rng.normal(size=samples)


def test_compare_says_the_fit_of_matlab():
    rng = np.random.default_rng(1)
    y, model = rng.normal(5.0, 2.0, 300), rng.normal(5.0, 2.0, 300)
    fit = 100.0 * (1.0 - np.linalg.norm(y - model) / np.linalg.norm(y - y.mean()))
    axes = plot.compare((np.zeros(300), y), model)
    assert [text.get_text() for text in axes.texts] == [f"fit {fit:.1f} %"]
    curves = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert_allclose(curves["measured"], y)
    assert_allclose(curves["model, free run"], model)
    assert axes.get_ylabel() == "y1"


@pytest.mark.parametrize(
    ("y", "says"),
    [
        (np.where(np.arange(100) // 20 == 1, np.nan, np.sin(np.arange(100.0))), "fit 100.0 %"),
        (np.ones(100), "no fit: nothing varies"),
    ],
)
def test_compare_counts_no_masked_sample_and_nothing_that_never_varies(y, says):
    assert plot.compare((np.ones(100), y), y).texts[0].get_text() == says


def outside(axes, line, skip=0):
    """Share of the values of a drawn line that the shaded band leaves out."""
    lag_s, values = line.get_xdata()[skip:], line.get_ydata()[skip:]
    corners = axes.collections[0].get_paths()[0].vertices
    half = np.array([np.abs(corners[np.isclose(corners[:, 0], at), 1]).max() for at in lag_s])
    return np.mean(np.abs(values) > half)


def test_white_noise_leaves_the_bands_of_resid_in_5_of_100_lags():
    rng = np.random.default_rng(7)
    own, cross = [], []
    for _ in range(60):
        u, y = rng.normal(size=(2, 800))
        first, second = Figure().subplots(2)
        plot.resid((u, y), np.zeros(800), ax=first)
        bars = first.lines[0]
        bars.set_data(bars.get_xdata()[1::3], bars.get_ydata()[1::3])
        own.append(outside(first, bars, skip=1))  # lag 0 is always 1
        plot.resid((u, y), np.zeros(800), cross=True, ax=second)
        cross.append(outside(second, second.lines[0]))
    assert np.mean(own) == pytest.approx(0.05, abs=0.01)
    assert np.mean(cross) == pytest.approx(0.05, abs=0.01)


def test_what_a_model_misses_of_an_input_is_seen_at_its_lag():
    u = np.random.default_rng(3).normal(size=2000)
    axes = plot.resid((u, np.roll(u, 4)), np.zeros(2000), cross=True)
    line = axes.lines[0]
    assert line.get_xdata()[np.argmax(np.abs(line.get_ydata()))] == 4.0
    assert axes.get_legend() is not None


def test_steps_of_a_linear_model_are_its_step_response_at_every_level():
    u = np.linspace(-1.0, 3.0, 200)
    axes = plot.steps(Lag(), (u, lag(u)), levels=4, seconds=20.0)
    drawn = [line.get_ydata() for line in axes.lines[:-1]]
    assert len(drawn) == 8
    time = np.arange(-1, 40)
    expected = np.where(time > 0, GAIN * (1.0 - DECAY ** np.maximum(time, 0)), 0.0)
    for number, y in enumerate(drawn):
        assert_allclose(y, (-1) ** number * expected, atol=1e-9)
    assert_allclose(axes.lines[0].get_xdata(), 0.5 * time)


def response(hz):
    """Gain of the lag at `hz`, sampled every 0.5 s."""
    return np.abs((1.0 - DECAY) * GAIN / (np.exp(2j * np.pi * hz * Lag.dt_s) - DECAY))


def test_frequency_is_the_transfer_function_within_its_interval():
    covered = []
    for seed in range(30):
        u = moved(seed)
        y = lag(u) + 0.2 * np.random.default_rng(100 + seed).normal(size=len(u))
        axes = plot.frequency((u, y), Lag(), ax=Figure().subplots())
        measured, model = axes.lines
        hz = measured.get_xdata()
        known = np.isfinite(measured.get_ydata())
        assert known.mean() > 0.9
        assert_allclose(model.get_ydata()[known], response(hz[known]), rtol=0.1)  # leakage
        paths = [path.vertices for path in axes.collections[0].get_paths()]
        corners = np.concatenate(paths)
        for at in hz[known]:
            ends = corners[np.isclose(corners[:, 0], at), 1]
            covered.append(ends.min() <= response(at) <= ends.max())
    # The share that the interval states, less what leakage at the lowest frequencies costs.
    assert np.mean(covered) == pytest.approx(0.95, abs=0.03)


def test_pages_draw_what_users_draw(view):
    made = view()
    page = overlay_figure(made)
    for ours, theirs in zip(
        [plot.events(made), plot.compare(made, channel="N1_pct")], page.axes, strict=False
    ):
        assert len(ours.lines) == len(theirs.lines)
        for line, other in zip(ours.lines, theirs.lines, strict=True):
            assert_allclose(line.get_ydata(), other.get_ydata())
    shown = plot.events(made, 1, "N1_pct")
    large = event_figure(made, made.events[1]).axes[1]
    for line, other in zip(shown.lines, large.lines, strict=False):
        assert_allclose(line.get_xydata(), other.get_xydata())
    tests = made.residuals[0]
    for cross in (False, True):
        given = plot.resid(tests, cross=cross).lines
        again = plot.resid(made, cross=cross).lines
        assert_allclose(given[0].get_ydata(), again[0].get_ydata())


def test_given_axes_are_drawn_on_and_get_no_legend(view):
    _, (first, second) = plt.subplots(2)
    assert plot.compare(view(), ax=first) is first
    assert plot.events(view(), ax=second) is second
    assert first.get_legend() is None
    assert plot.compare(view()).get_legend() is not None


def test_the_plot_of_a_network_is_a_comparison_of_its_free_run():
    u = moved(2, 400)
    axes = Narx.plot(Lag(), (u, lag(u)))
    assert axes.texts[0].get_text() == "fit 100.0 %"
    drawn = next(line for line in axes.lines if line.get_label() == "model, free run")
    assert_allclose(drawn.get_ydata(), lag(u))


U = np.zeros(100)
MODELS = (
    "expected a model, found str. Pass a run, a bundle, a Calibration, a Narx, or the outputs of "
    "any other as an array"
)
EVENTS = "expected what prepare or evaluate give, found data of type tuple"
STILL = "record 1: y1 does not follow u1 at any frequency"


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (
            lambda v: plot.compare(v, channel="EGT_C"),
            "{name}, channel EGT_C: there is no such output. There is N1_pct",
        ),
        (
            lambda v: plot.compare(v.log),
            "expected a model after a log. Give one, or the result of an evaluation",
        ),
        (
            lambda v: plot.compare(v.log, U),
            "outputs of a model come with a record. Pass (u, y) in the place of the log",
        ),
        (lambda _: plot.compare((U, U), "run"), MODELS),
        (
            lambda _: plot.compare([(U, U), (U, U)], Lag()),
            "expected one record, found 2. Draw one at a time",
        ),
        (
            lambda _: plot.compare((U, U), U[:50]),
            "record 1: expected outputs of the model of shape (100, 1), found (50, 1)",
        ),
        (
            lambda v: plot.events(v, 3),
            "{name}: there is no event 3, the log has 3 (0 is the first)",
        ),
        (lambda _: plot.events((U, U)), f"{EVENTS}. Events are found when logs are prepared"),
        (
            lambda _: plot.frequency((U, U), U, driver="u7"),
            "record 1, channel u7: there is no such input. There is u1",
        ),
        (
            lambda _: plot.frequency((U, U), U),
            f"{STILL}. Take a record in which the driver moves more",
        ),
        (
            lambda _: plot.frequency((U[:10], U[:10]), U[:10]),
            "expected at least 18 samples for a spectrum, found 10",
        ),
        (
            lambda _: plot.steps(Lag()),
            "a step needs data for its size and the other inputs. steps(model, data)",
        ),
        (
            lambda _: plot.steps(U, (U, U)),
            "expected a model that can be run, found its outputs",
        ),
    ],
)
def test_what_cannot_be_drawn_is_said(view, draw, message):
    shown = view()
    with pytest.raises(DataError) as caught:
        draw(shown)
    assert str(caught.value) == message.format(name=str(DataError("x", file=shown.name))[:-3])
