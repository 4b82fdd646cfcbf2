"""The paper's noise experiment: how near the fuser brings a noisy channel to the truth.

Section 3.3: Gaussian noise is added to the smoothed high-pressure speed, the noisy signal is fused
with the model's free run, and the network is fed with either in turn (figure 13).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from data_prep.prepare import hold_inputs
from eval.outcome import Outcome
from eval.scores import rms
from narxcal.calibration.fuser import FastFuser
from narxcal.calibration.fuser_config import FuserConfig
from narxcal.calibration.noise import estimate_noise
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.settings import Section

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from data_prep.log import Log
    from narxcal.calibration.bundle import Bundle

Power = Literal["mean_square", "variance"]
# Columns of the sweep that are errors, by what they are errors of.
CURVES: Final = {
    "raw": "raw measurement",
    "fused": "fused",
    "free_run": "free run",
    "fed_raw": "one step from raw",
    "fed_fused": "one step from fused",
}


class SweepConfig(Section):
    """Which noise is added, and how often.

    The signal-to-noise ratio is `10 log10(power / noise variance)`. The paper does not say which
    power: `mean_square` is that of the signal as it is (MATLAB's `awgn(..., "measured")`),
    `variance` that of the signal without its mean, some 17 dB less noise on a spool speed.
    """

    channel: str = "N2_pct"
    snr_db: tuple[float, ...] = (20.0, 25.0, 30.0, 35.0, 40.0, 45.0)
    seeds: tuple[int, ...] = (0, 1, 2)
    power: Power = "mean_square"
    fuser: FuserConfig = Field(default_factory=FuserConfig)


@dataclass(frozen=True, eq=False)
class Flight:
    """One log of the experiment, all `(time, n_out)` in the channels' units.

    `truth` are the smoothed measurements (NaN where there is none), `free_run` the model's
    own simulation. `feed` is its one-step prediction from a measured history,
    `DynamicCalibration.predict` with the inputs already given.
    """

    names: tuple[str, ...]
    dt_s: float
    truth: FloatArray
    free_run: FloatArray
    feed: Callable[[FloatArray], FloatArray] | None = None


def flight_of(bundle: Bundle, log: Log) -> Flight:
    """The experiment's view of one prepared log: its outputs as truth, the bundle's free run."""
    own = bundle.calibration.for_engine(log.source.engine, or_mean=True)
    inputs = hold_inputs(log, own.input_names).matrix(own.input_names)
    truth = log.matrix(own.output_names)
    return Flight(
        names=own.output_names,
        dt_s=own.dt_s,
        truth=truth,
        free_run=own.simulate(inputs, truth[0]),
        feed=lambda history: own.predict(inputs, history),
    )


def noise_deviation(signal: FloatArray, snr_db: float, power: Power) -> float:
    """Find the standard deviation of the noise that puts `signal` `(time,)` at `snr_db`."""
    known = signal[np.isfinite(signal)]
    strength = np.mean(known**2) if power == "mean_square" else np.var(known)
    return float(np.sqrt(strength / 10.0 ** (snr_db / 10.0)))


def snr_sweep(flight: Flight, config: SweepConfig | None = None) -> pd.DataFrame:
    """One row per ratio and seed, RMSE against the truth in the channel's unit.

    Columns: `snr_db`, `seed`, `noise_sd`; `raw`, `fused` and `free_run` (the model alone);
    `fed_raw` and `fed_fused`, the network's one-step prediction from either history (NaN without
    `feed`); `mean_nis` with its 95 % bounds `nis_low` and `nis_high`; `gated` samples. R and Q are
    estimated from each noisy signal; nothing is tuned, and the ratio is not used.

    Raises `DataError` for a channel that the flight has not, or has no truth of.
    """
    config = config or SweepConfig()
    if config.channel not in flight.names:
        raise DataError(
            "the flight has no such output",
            channel=config.channel,
            hint=f"It has {', '.join(flight.names)}",
        )
    at = flight.names.index(config.channel)
    if not np.isfinite(flight.truth[:, at]).any():
        raise DataError("there is no truth to add noise to", channel=config.channel)
    rows = [
        {"snr_db": snr, "seed": seed, **_trial(flight, at, (snr, seed), config)}
        for snr in config.snr_db
        for seed in config.seeds
    ]
    return pd.DataFrame(rows)


def summarise(sweep: pd.DataFrame) -> pd.DataFrame:
    """Per ratio: means over the seeds, `fused_spread` (largest minus smallest), `beats_both`.

    `beats_both` is true where the fused value is nearer to the truth than the raw measurement
    and than the free run, with every seed; `consistent` where the mean NIS is within its
    bounds with every seed.
    """
    sweep = sweep.assign(
        beats_both=sweep["fused"] < sweep[["raw", "free_run"]].min(axis=1),
        consistent=sweep["mean_nis"].between(sweep["nis_low"], sweep["nis_high"]),
    )
    groups = sweep.groupby("snr_db", sort=True)
    means = groups.mean(numeric_only=True).drop(columns=["seed", "beats_both", "consistent"])
    return means.assign(
        fused_spread=groups["fused"].max() - groups["fused"].min(),
        beats_both=groups["beats_both"].all(),
        consistent=groups["consistent"].all(),
    ).reset_index()


@dataclass(frozen=True, eq=False)
class NoiseSweep:
    """The experiment on one log; `table` is that of `summarise`."""

    log: str
    channel: str
    table: pd.DataFrame

    @property
    def curves(self) -> dict[str, FloatArray]:
        """Label -> RMSE at each ratio (snr,), for what was computed."""
        return {
            label: self.table[name].to_numpy(dtype=np.float64)
            for name, label in CURVES.items()
            if self.table[name].notna().any()
        }


def noise_outcome(sweeps: Sequence[NoiseSweep]) -> Outcome:
    """Pass where the fused value beats measurement and free run at every ratio of every log."""
    every = pd.concat([sweep.table for sweep in sweeps])
    won, consistent = int(every["beats_both"].sum()), int(every["consistent"].sum())
    headline = (
        f"At {won} of {len(every)} signal-to-noise ratios the fused value is nearer to the truth "
        "than both the measurement and the free run"
    )
    lines = (f"The filter is consistent (mean NIS within its 95 % band) at {consistent}.",)
    return Outcome(won == len(every), headline, lines)


def noisy(truth: FloatArray, setting: tuple[float, int], power: Power) -> FloatArray:
    """Add the sweep's noise at `setting` (ratio in dB, seed) to `truth` `(time,)`."""
    snr_db, seed = setting
    # A stream per ratio: the same seed at two ratios must not give the same noise twice.
    rng = np.random.default_rng([seed, round(10 * snr_db) % 2**32])
    deviation = noise_deviation(truth, snr_db, power)
    return np.asarray(truth + deviation * rng.normal(size=truth.shape))


def _trial(
    flight: Flight, at: int, setting: tuple[float, int], config: SweepConfig
) -> dict[str, float]:
    truth, free_run = flight.truth[:, at], flight.free_run[:, at]
    deviation = noise_deviation(truth, setting[0], config.power)
    measured = noisy(truth, setting, config.power)
    noise = estimate_noise(measured, free_run, flight.dt_s, (config.channel,))
    run = FastFuser(noise, config.fuser).run(free_run[:, None], measured[:, None])
    fused, check = run.values[:, 0], run.consistency()  # noqa: PD011 -- no data frame
    return {
        "noise_sd": deviation,
        "raw": rms(measured - truth),
        "fused": rms(fused - truth),
        "free_run": rms(free_run - truth),
        "fed_raw": _fed(flight, at, measured),
        "fed_fused": _fed(flight, at, fused),
        "mean_nis": check.mean_nis,
        "nis_low": check.low,
        "nis_high": check.high,
        "gated": check.gated,
    }


def _fed(flight: Flight, at: int, history: FloatArray) -> float:
    """RMSE of the one-step prediction when `history` takes the channel's place in the register."""
    if flight.feed is None:
        return float("nan")
    measured = flight.truth.copy()
    measured[:, at] = history
    return rms(flight.feed(measured)[:, at] - flight.truth[:, at])
