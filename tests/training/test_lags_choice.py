"""What [narx] leaves to "auto" of the lags: chosen by free runs over logs not fitted to."""

import numpy as np
import pytest

from data_prep.log import Log, Source
from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED, UNLIMITED
from training.config import RunConfig
from training.dynamics.lag_priors import Form, start_engine
from training.dynamics.lags import _CHOICE_GRID_S, LagChoice, _Judged, choose_form

INPUTS, OUTPUTS = ("TRA_deg", "ALT_ft", "Mach"), ("N1_pct", "N2_pct", "EGT_C")
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 240.0])
SCALES = {"centre": CENTRE, "half": HALF, "limit": np.full(3, 1e3)}
DT_S, HOLD, MOVES = 0.2, 75, 10


class Line:
    """Every output settles on a line over the lever."""

    input_names, output_names = INPUTS, OUTPUTS

    def outputs(self, inputs):
        return CENTRE + HALF * (inputs[:, :1] / 40.0 - 1.0)


def simple(**limits):
    """First-order lags, without limits of acceleration but for `limits` of the speeds."""
    free = {"log_up": UNLIMITED, "log_down": UNLIMITED, "slow_share": 0.0, "log_slow_tau": 1.5}
    rows = [
        {**free, "log_tau": 0.1, "air": 0.8, **limits},
        {**free, "log_tau": -0.2, "air": 0.8, **limits},
        {**free, "log_tau": -0.4, "core": -2.0},
    ]
    table = [[row.get(name, 0.0) for name in LIMITED] for row in rows]
    return LumpedEngine.of(OUTPUTS, {"parameters": np.array(table)}, SCALES)


def governed():
    """A control that holds N1: the core goes where the fan has to be driven to."""
    return start_engine(OUTPUTS, Form(governed=True), SCALES)[0]


def flight(number, lag, moves=MOVES):
    """The lever moves every 15 s at all altitudes."""
    rng = np.random.default_rng(number)
    part = np.repeat([-1.0, 1.0, *rng.uniform(-1.0, 1.0, moves - 2)], HOLD)
    part = np.convolve(np.pad(part, 2, "edge"), np.ones(5) / 5, "valid")
    height = np.repeat(rng.uniform(0.0, 1.0, moves), HOLD)
    inputs = np.column_stack([40.0 + 40.0 * part, 36000.0 * height, 0.8 * height])
    ss = Line().outputs(inputs)
    outputs = ss - lag.deviations(lag.drive(inputs, INPUTS, ss), np.zeros(3), DT_S)
    outputs = outputs + 0.02 * rng.normal(size=ss.shape) * [1.0, 1.0, 10.0]
    names, columns = (*INPUTS, *OUTPUTS), [*inputs.T, *outputs.T]
    channels = dict(zip(names, columns, strict=True))
    source = Source(f"{number}.csv")
    return Log(f"{number}.csv:", DT_S * np.arange(len(part)), channels, source=source)


def config(driver="TRA_deg", **narx):
    inputs = [driver, *INPUTS[1:]]
    return RunConfig.parse(
        {
            "events": {"driver": driver},
            "steady_state": {"inputs": inputs},
            "narx": {"outputs": list(OUTPUTS), **narx},
            "train": {"threads": 1, "local_trim": False},
        }
    )


@pytest.fixture
def asked(monkeypatch):
    """How many logs each fit was given; none is made."""
    found = []

    def fitted(config, samples, steady, dt_s):
        found.append(sum(len(each.ss) for each in samples))
        return TRUTHS["plain"]

    monkeypatch.setattr("training.dynamics.lags.fitted_form", fitted)
    return found


TRUTHS = {"plain": simple(), "limits": simple(log_up=-1.6, log_down=-1.6), "governed": governed()}


@pytest.mark.parametrize("true", TRUTHS)
def test_the_form_that_made_the_logs_is_found(true):
    logs = [flight(number, TRUTHS[true]) for number in (1, 2, 3)]
    found, choice = choose_form(config(), Line(), logs)
    assert choice.form == true
    assert (found.narx.lag_limits, found.narx.lag_governed) == (
        true == "limits",
        true == "governed",
    )
    assert set(choice.left) == {"plain", "limits", "governed"}
    assert choice.left[true] < 0.1


def test_stretches_of_a_single_recording_take_turns():
    log = flight(1, TRUTHS["limits"], moves=32)
    _, choice = choose_form(config(lag_governed=False), Line(), [log])
    assert choice.form == "limits"
    assert choice.left["limits"] < 0.5 * choice.left["plain"]


@pytest.mark.parametrize(
    ("narx", "form"),
    [
        ({"lag": False}, ""),
        ({"lag_limits": True}, "limits"),
        ({"lag_limits": False}, "plain"),
        ({"lag_governed": True}, "governed"),
        ({"lag_governed": True, "lag_limits": True}, "governed"),
    ],
)
def test_what_is_said_is_not_asked_of_the_logs(narx, form):
    found, choice = choose_form(config(**narx), Line(), [])
    assert choice == LagChoice(form)
    assert (found.narx.lag_limits, found.narx.lag_governed) == (
        form == "limits",
        form == "governed",
    )
    assert choice.row() == {"form": form, "left": {}}


@pytest.mark.parametrize(
    "said",
    [
        {"driver": "FF_kgph"},  # no control stands between fuel and engine
        {"lag_governed": False},
    ],
)
def test_lags_behind_a_control_are_offered_only_where_they_can_be(said, asked):
    log = flight(1, TRUTHS["plain"])
    log = log.with_channels({"FF_kgph": log["TRA_deg"]})
    _, choice = choose_form(config(**said), Line(), [log])
    assert set(choice.left) == {"plain", "limits"}
    assert len(asked) == 2 * 3


def test_engines_of_which_only_one_ever_moves_get_the_usual_form():
    rest = {name: np.full(MOVES * HOLD, 1.0) for name in INPUTS}
    settled = dict(zip(OUTPUTS, Line().outputs(np.ones((MOVES * HOLD, 3))).T, strict=True))
    logs = [flight(number, TRUTHS["limits"]) for number in (1, 2, 3)]
    logs[1:] = [log.with_channels({**rest, **settled}) for log in logs[1:]]
    _, choice = choose_form(config(lag_governed=False), Line(), logs)
    assert choice == LagChoice("plain", {})


@pytest.mark.parametrize(("said", "usual"), [({}, "governed"), ({"lag_governed": False}, "plain")])
def test_two_recordings_tell_nothing_against_the_usual_form(said, usual, asked):
    logs = [flight(number, TRUTHS["limits"]) for number in (1, 2)]
    assert choose_form(config(**said), Line(), logs)[1] == LagChoice(usual)
    assert not asked


@pytest.mark.parametrize(
    ("losses", "ratios", "form"),
    [
        ([-0.1, -0.2, -0.15], [0.1, 0.1, 0.1], "limits"),  # whatever the RMSE
        ([-0.1, -0.5, 0.3], [-0.1, -0.2, -0.15], "limits"),  # a tie, and less RMSE
        ([-0.1, -0.5, 0.3], [-0.1, -0.5, 0.3], "plain"),  # within a standard error
        ([0.1, 0.2, 0.1], [-0.1, -0.2, -0.15], "plain"),
        ([np.nan] * 3, [-0.2, -0.3, np.nan], "plain"),
    ],
)
def test_another_form_has_to_be_better_by_a_standard_error(losses, ratios, form, monkeypatch):
    def judged(_trial, config, _begins):
        pairs = zip(losses, ratios, strict=True)
        if not config.narx.lag_limits:
            pairs = [(0.0, 0.0)] * 3
        return [_Judged(0.5 + np.full((2, 1), loss), error) for loss, error in pairs]

    monkeypatch.setattr("training.dynamics.lags.Trial.judged", judged)
    logs = [flight(number, TRUTHS["plain"]) for number in (1, 2, 3)]
    assert choose_form(config(lag_governed=False), Line(), logs)[1].form == form


def test_an_output_that_one_recording_masks_does_not_end_the_comparison():
    logs = [flight(number, TRUTHS["limits"]) for number in (1, 2, 3)]
    logs[2] = logs[2].with_channels({"EGT_C": np.full(MOVES * HOLD, np.nan)})
    _, choice = choose_form(config(lag_governed=False), Line(), logs)
    assert choice.form == "limits"


def test_of_many_hours_every_so_many_th_recording_is_asked(monkeypatch, asked):
    monkeypatch.setattr("training.dynamics.lags._ENOUGH_S", 2.0 * MOVES * HOLD * DT_S)
    logs = [flight(number, TRUTHS["plain"]) for number in range(6)]
    both = [log for log in logs for _ in range(2)]  # two engines of each flight
    told = []
    choose_form(config(lag_governed=False), Line(), both, lambda *row: told.append(row[:2]))
    assert told == [(k, 6) for k in range(6)]
    coarse = MOVES * HOLD * DT_S / _CHOICE_GRID_S
    # Of three recordings, two with both engines are fitted to in each turn.
    assert asked == pytest.approx([4 * coarse] * 6, rel=0.02)
