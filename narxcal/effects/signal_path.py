"""Effects on the way of signals: from lever to control, and from a sensor to the recorder.

Those of a lever change the driving input alone, those of a sensor or of air data one channel each.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from narxcal.channels import SPOOLS
from narxcal.effects.base import Effect, Parameter, Run, Signals, unit
from narxcal.effects.operators import delay, play, rate_limit, smooth_delay, smooth_lag
from narxcal.support.arrays import FloatArray

LONGEST_S = 2.0
AIR_DATA = {"ALT_ft": (3000.0, "ft"), "Mach": (0.2, "-")}  # largest error, and its unit
FROZEN_S = 10.0  # that a record stands still
FASTEST_DEGPS = 400.0  # faster than any hand: no limit at all

_lever = partial(Effect, side="input")

# Play in the linkage, `width_deg` wide: the far end moves only while it is pushed. It rests in the
# middle of its play before the first sample.
THROTTLE_BACKLASH: Final = _lever(
    id="throttle_backlash",
    family="lever",
    meaning="play in the throttle linkage",
    manoeuvre="small lever reversals, slow and fast, about one trim",
    fixed=(Parameter("width_deg", "deg", 0.0, 15.0, 0.0, (0.7, 2.0, 5.0)),),
    arrives=lambda run, lever: play(lever, run.theta[:, 0]),
)

_DELAY: Final = Parameter("delay_s", "s", 0.0, LONGEST_S, 0.0, (0.1, 0.3, 0.8))


def _either_sign(signals: Signals, _channel: str) -> tuple[Parameter, ...]:
    """Where fuel drives, the delay may be negative: a meter that is late makes the engine early."""
    both = replace(_DELAY, low=-LONGEST_S, starts=(-0.3, -0.1, *_DELAY.starts))
    return (_DELAY if signals.governed else both,)


def _late_outputs(run: Run, y: FloatArray) -> FloatArray:
    """What the outputs were `delay_s` ago; conditions change little meanwhile."""
    delay_s, dt_s = run.theta[:, 0], run.signals.dt_s
    return np.stack([smooth_delay(y[..., j], delay_s, dt_s) for j in range(y.shape[-1])], axis=-1)


THROTTLE_DELAY: Final = _lever(
    id="throttle_delay",
    family="initiation",
    meaning="transport delay between throttle and control",
    manoeuvre="fast steps recorded at 4 Hz or more, on all channels",
    fixed=(_DELAY,),
    bounds=_either_sign,
    arrives=lambda run, lever: delay(lever, run.theta[:, 0], run.signals.dt_s),
    shifts=_late_outputs,
)


def _slow_lever(run: Run, lever: FloatArray) -> FloatArray:
    rate = np.where(run.theta[:, 0] < FASTEST_DEGPS, run.theta[:, 0], np.inf)
    return rate_limit(lever, rate, run.signals.dt_s)


THROTTLE_RATE_LIMIT: Final = _lever(
    id="throttle_rate_limit",
    family="transit",
    meaning="limit on how fast the control follows the throttle",
    manoeuvre="slams of three sizes: its transit time grows with the step",
    fixed=(Parameter("rate_degps", "deg/s", 1.0, FASTEST_DEGPS, FASTEST_DEGPS, (60.0, 20.0, 8.0)),),
    arrives=_slow_lever,
)

# What drives the engine is read `gain_pct` too large: a lever's scale, or a fuel meter's. Where
# fuel is the driver, fuel of another heating value gives the same signals.
DRIVER_GAIN: Final = _lever(
    id="driver_gain",
    family="offset",
    meaning="scale of the lever or fuel meter (or the fuel's heating value)",
    manoeuvre="holds over the whole range of the driver, on both engines",
    fixed=(Parameter("gain_pct", "%", -15.0, 15.0, 0.0, (-2.5, 2.5)),),
    arrives=lambda run, lever: lever * (1.0 + 0.01 * run.theta[:, :1]),
)

# The control reads the lever `bias_deg` too high.
THROTTLE_BIAS: Final = _lever(
    id="throttle_bias",
    family="offset",
    meaning="offset of the throttle position",
    manoeuvre="holds at several lever positions, idle stop and full power included",
    fixed=(Parameter("bias_deg", "deg", -8.0, 8.0, 0.0, (-2.0, 2.0)),),
    arrives=lambda run, lever: lever + run.theta[:, :1],
)

# Errors of the recorded altitude or Mach number: the simulator flew it, the engine did not. What
# the record lost is looked up where it goes on, so that no more of it is known than that.
_air_data = partial(
    Effect,
    side="input",
    family="air data",
    per_channel=True,
    acts=lambda signals, channel: channel in AIR_DATA and channel in signals.active,
)


def _air_offset(_signals: Signals, channel: str) -> tuple[Parameter, ...]:
    most, text = AIR_DATA[channel]
    return (Parameter("bias", text, -most, most, 0.0, (-0.15 * most, 0.15 * most)),)


def _less_offset(run: Run, recorded: FloatArray) -> FloatArray:
    """The record less its offset, no Mach number below 0."""
    bias, low = run.theta[:, :1], 0.0 if run.channel == "Mach" else -np.inf
    return np.where(bias == 0.0, recorded, np.maximum(recorded - bias, low))


AIR_DATA_BIAS: Final = _air_data(
    id="air_data_bias",
    meaning="one channel recorded with an offset",
    manoeuvre="holds at one lever position, at low and at high altitude and Mach",
    bounds=_air_offset,
    arrives=_less_offset,
)

AIR_DATA_DELAY: Final = _air_data(
    id="air_data_delay",
    meaning="one channel of the air data recorded late",
    manoeuvre="fast climbs and descents at one lever position",
    fixed=(Parameter("late_s", "s", 0.0, 60.0, 0.0, (3.0, 15.0)),),
    arrives=lambda run, recorded: delay(recorded, -run.theta[:, 0], run.signals.dt_s),
)


def _thawed(run: Run, recorded: FloatArray) -> FloatArray:
    """The record, with straight lines in the place of what stands still."""
    found, time = recorded.copy(), np.arange(recorded.shape[1])
    for k, row in enumerate(recorded):
        starts = np.flatnonzero(np.diff(row, prepend=np.nan) != 0.0)
        lengths = np.diff(np.append(starts, len(row)))
        held = np.repeat(lengths * run.signals.dt_s >= FROZEN_S, lengths)
        held[starts] = False
        corners = time[~held]
        found[k] += run.theta[k, 0] * (np.interp(time, corners, row[corners]) - row)
    return found


# While the record stands still to the digit, the channel goes on to where it goes on, by `share`
# of the way. A level flight stands still as well: the record then goes on where it stood.
AIR_DATA_FROZEN: Final = _air_data(
    id="air_data_frozen",
    meaning="one channel frozen in the record for a while",
    manoeuvre="climbs and descents with a second source of the air data",
    fixed=(Parameter("share", "-", 0.0, 1.0, 0.0, (0.5,)),),
    arrives=_thawed,
)

_sensor = partial(Effect, side="sensor", per_channel=True)
_LAG: Final = (
    Parameter("tau_s", "s", 0.0, 6.0, 0.0, (0.2, 0.8, 3.0)),
    Parameter("own_s", "s", 0.0, 2.5, 0.0, (0.05, 0.6)),
)
_COUNTED: Final = Parameter("own_s", "s", 0.0, 0.5, 0.0, (0.05, 0.3))  # of a speed


def _slow_reading(run: Run, value: FloatArray) -> FloatArray:
    tau, own = run.theta[:, 0], run.theta[:, 1]
    passed = (own / np.maximum(own + tau, 1e-9))[:, None]
    lagged = smooth_lag(value, own + tau, run.signals.dt_s)
    # Without an added lag, or without a lag at all, nothing may change, to the bit.
    same = (tau == 0.0)[:, None]
    return np.asarray(np.where(same, value, lagged + passed * (value - lagged)))


# The sensor's time constant is `tau_s` longer than the simulator has it. The simulator's channel
# may be behind a lag of its own, `own_s`, which is then replaced: `(1 + own s) / (1 + (own + tau)
# s)`. With `own_s` = 0 it is one more lag in series. A probe takes some 5 s at most, at idle and
# altitude (unverified): what is slower is the metal round it. A speed is counted from pulses, in a
# fraction of a second: where a lag of seconds is replaced by a longer one, that is a rotor which
# follows the other more slowly, and no sensor.
SENSOR_LAG: Final = _sensor(
    id="sensor_lag",
    family="channel lag",
    meaning="lag of one sensor",
    manoeuvre="fast steps: a lag rounds one channel off, a delay only shifts it",
    fixed=_LAG,
    bounds=lambda _signals, channel: (_LAG[0], _COUNTED) if channel in SPOOLS else _LAG,
    reads=_slow_reading,
)

FLOWMETER_DYNAMICS: Final = replace(
    SENSOR_LAG, id="flowmeter_dynamics", meaning="lag of the fuel flowmeter"
)

SENSOR_BIAS: Final = _sensor(
    id="sensor_bias",
    family="offset",
    meaning="constant offset of one sensor",
    manoeuvre="holds at idle and at full power, on both engines",
    bounds=lambda signals, channel: (_linear(signals, channel, "bias", 0.5),),
    reads=lambda run, value: value + run.theta[:, :1],
)

SENSOR_GAIN: Final = _sensor(
    id="sensor_gain",
    family="offset",
    meaning="scale of one sensor",
    manoeuvre="holds over the whole range, on both engines",
    fixed=(Parameter("gain_pct", "%", -20.0, 20.0, 0.0, linear=True),),
    reads=lambda run, value: value * (1.0 + 0.01 * run.theta[:, :1]),
)


def _linear(signals: Signals, channel: str, name: str, ranges: float, per: str = "") -> Parameter:
    most = ranges * signals.width(channel)
    return Parameter(name, unit(channel) + per, -most, most, 0.0, linear=True)


def _drifted(run: Run, value: FloatArray) -> FloatArray:
    hours = np.arange(value.shape[1]) * run.signals.dt_s / 3600.0
    return value + run.theta[:, :1] * hours


# The offset grows from nothing at the start of each flight, up to the range in three minutes.
SENSOR_DRIFT: Final = _sensor(
    id="sensor_drift",
    family="slow offset",
    meaning="drift of one sensor",
    manoeuvre="a long hold at constant throttle: a drift goes on",
    bounds=lambda signals, channel: (_linear(signals, channel, "rate_per_h", 20.0, "/h"),),
    reads=_drifted,
)

TIME_SKEW: Final = _sensor(
    id="time_skew",
    family="channel lag",
    meaning="one channel recorded late",
    manoeuvre="fast steps: a delay shifts one channel, a lag rounds it off",
    fixed=(Parameter("skew_s", "s", 0.0, LONGEST_S, 0.0, (0.1, 0.3, 0.8)),),
    reads=lambda run, value: smooth_delay(value, run.theta[:, 0], run.signals.dt_s),
)
