"""Effects in an anchored emulator against the engine itself with the effect in it."""

import numpy as np
import pytest

from narxcal.effects import Flights, effect, respond
from narxcal.support.errors import ConfigError

DT = 0.125


class Drifting:
    """The emulator of someone who got every run wrong, with and without an effect."""

    def __init__(self, engine):
        self.engine = engine

    def run(self, flights, told, pace=None, shift=None):
        right = self.engine.run(flights, told, pace, shift)
        return 0.8 * right + np.sin(np.arange(right.shape[1]))[:, None]


def test_no_effect_is_no_difference_however_wrong_the_emulator(acting, neutral, flights, engine):
    found = respond([(acting, neutral(acting))], flights, Drifting(engine))
    np.testing.assert_array_equal(found[0], flights.y)


def test_what_an_emulator_gets_wrong_in_both_runs_cancels(flights, engine):
    setting = (effect("spool_lag"), np.array([[1.5]]))
    right, wrong = (respond([setting], flights, e) for e in (engine, Drifting(engine)))
    np.testing.assert_allclose(wrong - flights.y, 0.8 * (right - flights.y), atol=1e-9)


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("throttle_backlash", 4.0),
        ("throttle_rate_limit", 6.0),
        ("throttle_bias", 2.5),
    ],
)
def test_on_an_exact_emulator_an_input_effect_is_the_engine_told_so(
    name, theta, flights, fly, engine
):
    setting = (effect(name), np.array([[theta]]))
    found = respond([setting], flights, engine)[0]
    told = flights.u.copy()
    lever = told[..., 0]
    if name == "throttle_bias":
        lever += theta
    else:
        for row in lever:
            at = row[0]
            for k, value in enumerate(row):
                if name == "throttle_backlash":
                    at = min(max(at, value - 0.5 * theta), value + 0.5 * theta)
                else:
                    at += min(max(value - at, -theta * DT), theta * DT)
                row[k] = at
    rest = found[:, 0] if name == "throttle_bias" else flights.y[:, 0]
    exact = np.stack([engine.simulate(u, start) for u, start in zip(told, rest, strict=True)])
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_an_engine_that_is_told_wrong_from_the_start_starts_at_rest(flights, fly, engine):
    u = np.repeat(flights.u[:, :1], 20, axis=1)
    u[..., 4:] = 0.0
    of, told = fly(u), u + np.array([2.5, *np.zeros(8)])
    found = respond([(effect("throttle_bias"), np.array([[2.5]]))], of, engine)[0]
    np.testing.assert_allclose(found, fly(told).y, atol=1e-2)


def test_an_engine_that_is_told_late_does_the_same_late(flights, fly, engine):
    u = np.repeat(flights.u[:, :1], 240, axis=1)
    u[..., 0], u[..., 4:] = flights.u[..., 0], 0.0
    of, told = fly(u), u.copy()
    told[:, 3:, 0], told[:, :3, 0] = u[:, :-3, 0], u[:, :1, 0]
    found = respond([(effect("throttle_delay"), np.array([[3 * DT]]))], of, None)[0]
    exact = np.stack([engine.simulate(row, y[0]) for row, y in zip(told, of.y, strict=True)])
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_an_idle_is_taken_up_as_the_engine_moves(flights, engine):
    """Fuel flow is a lag of 0.3 s: the closed form of its own shift, step by step."""
    theta = np.array([[0.4, 0.0, 0.0, 0.0, 50.0]])
    found = respond([(effect("idle_schedule"), theta)], flights, engine)[0] - flights.y
    low, high = flights.signals.lever
    lever = (flights.u[..., 0] - low) / (high - low)
    to = 50.0 * flights.u[..., 4] * np.maximum(0.0, 1.0 - lever / 0.4)
    assert np.ptp(to) > 40.0
    late = to.copy()
    for k in range(1, late.shape[1]):
        late[:, k] = late[:, k - 1] + DT / 0.3 * (to[:, k - 1] - late[:, k - 1])
    np.testing.assert_allclose(found[..., 3], late, atol=1e-9)
    np.testing.assert_allclose(found[..., :3], 0.0, atol=1e-9)


def test_a_slam_from_another_idle_is_still_another_one_where_the_idle_is_left(flights, fly, engine):
    """The lever is past the floor at once, the speed is not."""
    theta = np.array([[0.3, 4.0, 2.0, 16.0, 0.0]])
    u = np.repeat(flights.u[:, :1], 80, axis=1)
    u[..., 0], u[..., 4:] = flights.signals.lever[0], 0.0
    u[..., 4], u[:, 40:, 0] = 1.0, 60.0
    of = fly(u)
    found = respond([(effect("idle_schedule"), theta)], of, engine)[0] - of.y
    np.testing.assert_allclose(found[:, 39, :3], np.tile(theta[0, 1:4], (3, 1)), rtol=0.05)
    assert (found[:, 44, 0] > 1.5).all()
    assert (np.abs(found[:, -1, :3]) < 0.2 * theta[0, 1:4]).all()


def test_another_idle_and_another_pace_go_together(flights, engine):
    """What both do is no sum: the shift of a slower engine is taken up more slowly."""
    idle = (effect("idle_schedule"), np.array([[0.4, 4.0, 2.0, 16.0, 50.0]]))
    slow = (effect("spool_lag"), np.array([[2.0]]))
    both, one, other = (
        respond(each, flights, engine)[0] for each in ([idle, slow], [idle], [slow])
    )
    np.testing.assert_allclose(both[:, 0], one[:, 0], atol=1e-9)
    assert np.abs(both - one - other + flights.y).max() > 0.3
    swapped = respond([slow, idle], flights, engine)[0]
    np.testing.assert_array_equal(both, swapped)


def test_effects_act_in_the_order_of_their_places(flights, engine):
    """However they are listed: lever, rotors, sensor."""
    settings = [
        (effect("sensor_lag:EGT_C"), np.array([[1.0, 0.0]])),
        (effect("spool_lag"), np.array([[1.3]])),
        (effect("throttle_delay"), np.array([[0.4]])),
    ]
    found = respond(settings, flights, engine)
    np.testing.assert_array_equal(found, respond(settings[::-1], flights, engine))
    inner = respond(settings[1:], flights, engine)[0]
    of = Flights(flights.signals, flights.u, inner, flights.lengths)
    np.testing.assert_array_equal(found, respond(settings[:1], of, None))


@pytest.mark.parametrize("name", ["throttle_bias", "spool_lag"])
def test_an_effect_inside_the_engine_needs_an_emulator(name, flights):
    with pytest.raises(ConfigError, match=f"'{name}' acts inside the engine: it needs an emulator"):
        respond([(effect(name), np.array([[1.5]]))], flights, None)


class Counting:
    """An engine that says how many rows it was run for."""

    def __init__(self, engine):
        self.engine, self.rows = engine, []

    def run(self, flights, told, pace=None, shift=None):
        found = self.engine.run(flights, told, pace, shift)
        self.rows.append(len(found))
        return found


def test_runs_at_one_and_the_same_pace_are_made_once(flights, engine):
    """Three heat soaks of two paces: the shares of the readings are none of the emulator's."""
    soak, counting = effect("heat_soak"), Counting(engine)
    sizes = len(soak.parameters(flights.signals)) - 3
    thetas = [[30.0, 1.0, *np.full(sizes, share), loss] for share, loss in ((0, 2), (1, 2), (1, 4))]
    together = respond([(soak, np.array(thetas, np.float64))], flights, counting)
    assert counting.rows == [2 * len(flights.u), len(flights.u)]
    for theta, found in zip(thetas, together, strict=True):
        alone = respond([(soak, np.array([theta], np.float64))], flights, engine)[0]
        np.testing.assert_array_equal(found, alone)
