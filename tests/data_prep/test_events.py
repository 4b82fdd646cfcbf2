"""Trend Intercept: where events begin and end, and what they never do."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.events import EventsConfig, find_events, needs_condition
from data_prep.log import Log
from narxcal.support.errors import DataError

DT = 1 / 32
FREE = EventsConfig(condition="")


def lag(values, tau_s=1.0, dt_s=DT):
    out = np.empty_like(values)
    out[0] = values[0]
    share = 1 - np.exp(-dt_s / tau_s)
    for k in range(1, len(values)):
        out[k] = out[k - 1] + share * (values[k] - out[k - 1])
    return out


def lever_of(moves, count, level=20.0):
    """Piecewise linear lever: (last sample at rest, samples of movement, new level)."""
    knots, levels = [0], [level]
    for start, length, target in moves:
        knots += [start, start + length]
        levels += [levels[-1], target]
    return np.interp(np.arange(count), [*knots, count], [*levels, levels[-1]])


def log_of(lever, **more):
    channels = {"TRA_deg": lever, "N1_pct": lag(30 + lever), **more}
    return Log("flight:left", np.arange(len(lever)) * DT, channels)


def moves_log(moves, count=4000, **more):
    return log_of(lever_of(moves, count), **more)


PUSH_PULL = [(500, 16, 65.0), (2000, 16, 20.0)]


def test_push_and_pull_are_found_with_their_start_label_and_levels():
    push, pull = find_events(moves_log(PUSH_PULL), FREE)
    assert (push.start, push.label, push.speed) == (500, 0, "fast")
    assert (pull.start, pull.label, pull.speed) == (2000, 1, "fast")
    assert (push.lever_before, push.lever_after) == (20.0, 65.0)
    assert (pull.lever_before, pull.lever_after) == (65.0, 20.0)
    assert push.start_s == 500 * DT
    assert push.log == "flight:left"


def test_an_event_lasts_until_driver_and_response_have_settled():
    log = moves_log(PUSH_PULL)
    for event in find_events(log, FREE):
        assert event.settled
        assert not event.interrupted
        final = log["N1_pct"][event.stop + 200]
        assert abs(log["N1_pct"][event.stop - 1] - final) < 0.01 * 45
    # With a slower engine the same lever movement makes a longer event.
    slow = log.with_channels({"N1_pct": lag(30 + log["TRA_deg"], 4.0)})
    assert find_events(slow, FREE)[0].stop > find_events(log, FREE)[0].stop + 100


def test_every_named_response_has_to_settle():
    lever = lever_of(PUSH_PULL, 4000)
    log = log_of(lever, EGT_C=lag(500 + 4 * lever, 5.0))
    both = EventsConfig(condition="", response=("N1_pct", "EGT_C"))
    assert find_events(log, both)[0].stop > find_events(log, FREE)[0].stop + 100


def test_reslam_before_settling_interrupts_the_event():
    first, second, third = find_events(
        moves_log([(500, 16, 65.0), (560, 16, 22.0), (700, 9, 60.0)]), FREE
    )
    assert (first.start, first.stop) == (500, 560)
    assert (second.start, second.stop) == (560, 700)
    assert first.interrupted
    assert not first.settled
    assert [first.label, second.label, third.label] == [0, 1, 0]
    assert third.settled
    assert not third.interrupted
    assert (first.lever_after, second.lever_after) == (65.0, 22.0)


def test_a_lever_that_turns_round_at_once_gives_two_events():
    first, second = find_events(moves_log([(500, 20, 65.0), (520, 20, 20.0)]), FREE)
    assert (first.start, first.stop, first.label) == (500, 520, 0)
    assert (second.start, second.label) == (520, 1)


def test_fast_slow_and_small_moves_are_told_apart():
    log = moves_log([(500, 30, 65.0), (1500, 400, 40.0), (2500, 10, 44.0)])
    assert [event.speed for event in find_events(log, FREE)] == ["fast", "slow", "small"]


def test_the_end_of_a_log_leaves_an_event_unsettled_but_not_interrupted():
    (event,) = find_events(moves_log([(500, 16, 65.0)], count=530), FREE)
    assert (event.stop, event.settled, event.interrupted) == (530, False, False)


def test_longest_event_is_limited():
    limited = FREE.model_copy(update={"max_length_s": 2.0})
    event = find_events(moves_log(PUSH_PULL), limited)[0]
    assert event.stop - event.start == 64
    assert not event.settled


def test_a_response_that_never_settles_is_said_so():
    lever = lever_of([(500, 16, 65.0)], 4000)
    hunting = 30 + lever + 3 * np.sin(np.arange(4000) / 10)
    event = find_events(
        Log("f", np.arange(4000) * DT, {"TRA_deg": lever, "N1_pct": hunting}), FREE
    )[0]
    assert not event.settled
    assert event.stop - event.start == 60 * 32


@pytest.mark.parametrize(
    "lever",
    [
        np.full(2000, 30.0),
        np.where(np.arange(2000) % 7 == 0, 30.1, 30.0),  # it toggles by its resolution
        *(np.linspace(0, 60, count) for count in (1, 2, 3, 10)),
    ],
)
def test_a_still_lever_and_a_short_log_have_no_events(lever):
    assert find_events(log_of(lever), FREE) == []


def test_noise_alone_has_no_events():
    rng = np.random.default_rng(0)
    noisy = EventsConfig(condition="", driver="FF_kgph")
    log = log_of(np.zeros(20_000), FF_kgph=500 + rng.normal(0, 3, 20_000))
    assert find_events(log, noisy) == []


def test_an_absolute_change_replaces_the_relative_one():
    log = moves_log([(500, 10, 65.0), (1500, 10, 62.0)])
    absolute = FREE.model_copy(update={"min_change": 4.0})
    assert [event.start for event in find_events(log, FREE)] == [500, 1500]
    assert [event.start for event in find_events(log, absolute)] == [500]


def test_a_drift_slower_than_the_window_allows_is_no_event():
    lever = lever_of([(500, 16, 65.0), (1500, 2000, 63.0)], 4000)
    assert [event.start for event in find_events(log_of(lever), FREE)] == [500]


@given(
    start=st.integers(300, 900),
    length=st.integers(1, 300),
    change=st.floats(8, 50).flatmap(lambda size: st.sampled_from([size, -size])),
)
def test_start_of_a_clean_ramp_is_exact(start, length, change):
    lever = lever_of([(start, length, 60 + change)], 2000, level=60.0)
    (event,) = find_events(log_of(lever), FREE)
    assert event.start == start
    assert event.label == (0 if change > 0 else 1)


@given(seed=st.integers(0, 10_000), length=st.integers(2, 200), noise=st.sampled_from([0.02, 0.1]))
def test_start_of_a_noisy_ramp_is_found_within_two_samples(seed, length, noise):
    rng = np.random.default_rng(seed)
    lever = lever_of([(700, length, 65.0)], 2000) + rng.normal(0, noise, 2000)
    (event,) = find_events(log_of(lever), FREE)
    assert abs(event.start - 700) <= 2


def random_moves(seed):
    rng = np.random.default_rng(seed)
    moves, at, level = [], 400, 20.0
    while at < 3500:
        length = int(rng.choice([1, 8, 16, 40, 200]))
        target = float(rng.uniform(5, 70))
        moves.append((at, length, target if abs(target - level) > 6 else level))
        level = moves[-1][2]
        at += length + int(rng.choice([1, 20, 60, 300, 700]))
    return moves


def strip(events):
    return [
        replace(event, log="", start_s=0.0, lever_before=0.0, lever_after=0.0) for event in events
    ]


@given(seed=st.integers(0, 10_000))
def test_events_never_overlap_and_lie_inside_the_log(seed):
    log = moves_log(random_moves(seed), count=4000)
    events = find_events(log, FREE)
    for event in events:
        assert 0 <= event.start < event.stop <= len(log)
        assert not (event.settled and event.interrupted)
    for one, two in itertools.pairwise(events):
        assert one.stop <= two.start
        assert one.interrupted == (one.stop == two.start and not one.settled)


def test_random_moves_give_the_properties_here_something_to_hold_for():
    free = [find_events(moves_log(random_moves(seed), count=4000), FREE) for seed in range(20)]
    assert sum(map(len, free)) > 60
    assert sum(event.interrupted for events in free for event in events) > 10
    assert sum(event.settled for events in free for event in events) > 10


@given(seed=st.integers(0, 10_000), shift_s=st.floats(-1e4, 1e4))
def test_later_clocks_only_shift_the_start_time(seed, shift_s):
    log = moves_log(random_moves(seed))
    later = replace(log, time_s=log.time_s + shift_s)
    events = find_events(log, FREE)
    assert strip(find_events(later, FREE)) == strip(events)


@given(seed=st.integers(0, 10_000), ahead=st.integers(0, 500))
def test_rest_before_the_log_only_shifts_the_samples(seed, ahead):
    absolute = FREE.model_copy(update={"min_change": 1.5, "settle_fraction": 0.05})
    log = moves_log(random_moves(seed))
    padded = {name: np.concatenate((np.full(ahead, x[0]), x)) for name, x in log.channels.items()}
    longer = Log(log.name, np.arange(len(log) + ahead) * DT, padded)
    starts = [event.start + ahead for event in find_events(log, absolute)]
    assert [event.start for event in find_events(longer, absolute)] == starts


@given(seed=st.integers(0, 10_000))
def test_a_mirrored_lever_swaps_the_labels(seed):
    log = moves_log(random_moves(seed))
    mirrored = log.with_channels({name: 70 - log[name] for name in log.channels})
    events = find_events(log, FREE)
    swapped = [replace(event, label=1 - event.label) for event in find_events(mirrored, FREE)]
    assert strip(swapped) == strip(events)


@given(seed=st.integers(0, 10_000), scale=st.sampled_from([0.25, 2.0, 8.0]))
def test_the_unit_of_the_driver_does_not_matter(seed, scale):
    """A driver outside the levers, which alone have an absolute resolution."""
    config = EventsConfig(condition="", driver="FF_kgph")
    log = moves_log(random_moves(seed))
    one = log.with_channels({"FF_kgph": log["TRA_deg"]})
    other = log.with_channels({"FF_kgph": scale * log["TRA_deg"]})
    assert strip(find_events(other, config)) == strip(find_events(one, config))


@given(seed=st.integers(0, 10_000))
def test_no_event_holds_a_sample_that_violates_the_condition(seed):
    rng = np.random.default_rng(seed)
    ground = np.repeat(rng.integers(0, 2, 40), 100).astype(float)
    ground[rng.integers(0, 4000, 3)] = np.nan
    log = moves_log(random_moves(seed), WOW=ground)
    for event in find_events(log, EventsConfig()):
        assert (ground[event.start : event.stop] == 0).all()


def test_condition_can_be_another_channel_another_value_or_none():
    lever = lever_of(PUSH_PULL, 4000)
    ground = np.where(np.arange(4000) < 1500, 1.0, 0.0)
    log = log_of(lever, WOW=ground, NAI=1 - ground)
    starts = {
        key: [event.start for event in find_events(log, EventsConfig(**config))]
        for key, config in {
            "default": {},
            "on ground": {"condition_value": 1.0},
            "anti-ice": {"condition": "NAI", "condition_value": 0.0},
            "all": {"condition": ""},
        }.items()
    }
    assert starts == {"default": [2000], "on ground": [500], "anti-ice": [500], "all": [500, 2000]}


def test_missing_condition_channel_says_what_to_do():
    with pytest.raises(DataError) as error:
        find_events(moves_log(PUSH_PULL), EventsConfig(condition="WOW"))
    assert str(error.value) == (
        "flight:left, channel WOW: events need their condition channel, and the log has none. "
        'Derive it in [logs], or set condition = "" in [events]'
    )


def test_what_no_channel_tells_bars_no_event_and_is_said():
    bare, told = moves_log(PUSH_PULL), moves_log(PUSH_PULL, WOW=np.ones(4000))
    assert find_events(bare) == find_events(bare, FREE)
    assert find_events(told) == []
    said = "there is no WOW channel: events on the ground count like those in flight"
    assert needs_condition(bare, EventsConfig()) == said
    assert needs_condition(told, EventsConfig()) == needs_condition(bare, FREE) == ""


@pytest.mark.parametrize(("key", "name"), [("driver", "FF_kgph"), ("response", ("N2_pct",))])
def test_missing_driver_or_response_is_an_error(key, name):
    channel = name if isinstance(name, str) else name[0]
    with pytest.raises(DataError) as error:
        find_events(moves_log(PUSH_PULL), EventsConfig(condition="", **{key: name}))
    assert str(error.value) == (
        f"flight:left, channel {channel}: the log has no such channel. It has TRA_deg, N1_pct"
    )


@pytest.mark.parametrize(
    ("gaps", "starts"), [([(1000, 1010), (520, 523)], [500, 2000]), ([(450, 600)], [2000])]
)
def test_short_gaps_in_the_driver_are_bridged_and_a_move_in_a_long_one_is_no_event(gaps, starts):
    clean = lever_of(PUSH_PULL, 4000)
    lever = clean.copy()
    for start, stop in gaps:
        lever[start:stop] = np.nan
    assert [event.start for event in find_events(log_of(lever, N1_pct=lag(clean)), FREE)] == starts


def test_an_event_ends_where_the_driver_is_lost():
    clean = lever_of(PUSH_PULL, 4000)
    lever = clean.copy()
    lever[540:700] = np.nan
    event = find_events(log_of(lever, N1_pct=lag(clean)), FREE)[0]
    assert (event.start, event.stop, event.settled) == (500, 540, False)


def test_a_masked_response_cannot_have_settled_while_masked():
    log = moves_log(PUSH_PULL)
    speed = log["N1_pct"].copy()
    speed[510:1200] = np.nan
    event = find_events(log.with_channels({"N1_pct": speed}), FREE)[0]
    assert event.settled
    assert event.stop > 1200


def test_a_response_that_was_never_recorded_leaves_the_driver_to_decide():
    log = moves_log(PUSH_PULL, N2_pct=np.full(4000, np.nan))
    event = find_events(log, EventsConfig(condition="", response=("N2_pct",)))[0]
    assert event.settled


def test_several_logs_at_once_are_no_log():
    with pytest.raises(DataError) as error:
        find_events([moves_log(PUSH_PULL)])
    assert str(error.value) == (
        "events are those of one log, found a list. "
        "Call it for each: [find_events(log) for log in logs]"
    )
