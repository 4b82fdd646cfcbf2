"""Section 3.3 of the paper: N2 with strong noise, fused with the model and fed to the network.

Gaussian noise is added to the smoothed high-pressure speed, the noisy signal is fused with the
model's free run, and the network is fed with either in turn (figure 13). The signal-to-noise ratio
is `10 log10(mean square of the signal / noise variance)`, as in MATLAB's `awgn(..., "measured")`;
the paper does not say whether its power is that of the signal or of its variance, which gives some
17 dB less noise on a spool speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pandas as pd

from data_prep.log import Log
from data_prep.prepare import hold_inputs
from eval.judging.scores import rms
from eval.report import figures, tables
from eval.report.style import Picture
from eval.reproduce.data import DataSets, Effort, numbered
from eval.reproduce.study import Claim, Study, claim
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.fuser import FastFuser, FusedRun
from narxcal.calibration.fuser_config import FuserConfig
from narxcal.calibration.noise import estimate_noise
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray
from narxcal.support.progress import Progress, silent

NOISE_SETS = (2, 9, 10)
SNR_DB = (25.0, 30.0, 35.0, 40.0, 44.0)  # all below the paper's 45 dB
SHOWN_DB = 35.0
_SHOWN_S = 20.0
# Columns of the sweep that are errors, by what they are errors of.
CURVES: Final = {
    "raw": "raw measurement",
    "fused": "fused",
    "free_run": "free run",
    "fed_raw": "one step from raw",
    "fed_fused": "one step from fused",
}


@dataclass(frozen=True, eq=False)
class Flight:
    """One log of the experiment, all `(time, n_out)` in the channels' units.

    `truth` are the smoothed measurements (NaN where there is none), `free_run` the model's
    own simulation. `feed` is its one-step prediction from a measured history. Noise is added to
    `channel`.
    """

    names: tuple[str, ...]
    dt_s: float
    truth: FloatArray
    free_run: FloatArray
    feed: Callable[[FloatArray], FloatArray]
    channel: str = "N2_pct"
    fuser: FuserConfig = field(default_factory=FuserConfig)

    @property
    def at(self) -> int:
        """Column of the channel."""
        return self.names.index(self.channel)

    def fed(self, history: FloatArray) -> float:
        """RMSE of the one-step prediction when `history` takes the channel's place."""
        measured = self.truth.copy()
        measured[:, self.at] = history
        return rms(self.feed(measured)[:, self.at] - self.truth[:, self.at])

    def fused(self, measured: FloatArray) -> FusedRun:
        """The channel as `measured` (time,), fused with the free run."""
        free_run = self.free_run[:, [self.at]]
        found = estimate_noise(measured, free_run[:, 0], self.dt_s, (self.channel,))
        return FastFuser(found, self.fuser).run(free_run, measured[:, None])


@dataclass(frozen=True, eq=False)
class NoiseSweep:
    """The experiment on one log; `table` is that of `summarise`."""

    log: str
    channel: str
    table: pd.DataFrame

    @property
    def curves(self) -> dict[str, FloatArray]:
        """Label -> RMSE at each ratio (snr,)."""
        return {
            label: self.table[name].to_numpy(dtype=np.float64) for name, label in CURVES.items()
        }


def flight_of(data: DataSets, bundle: Bundle, log: Log) -> Flight:
    """One prepared log: its outputs as truth, the bundle's free run; noise on its last speed."""
    own = bundle.calibration.for_engine(log.source.engine, or_mean=True)
    inputs = hold_inputs(log, own.input_names).matrix(own.input_names)
    truth = log.matrix(own.output_names)
    return Flight(
        own.output_names,
        own.dt_s,
        truth,
        own.simulate(inputs, truth[0]),
        lambda history: own.predict(inputs, history),
        data.speeds[-1],
        data.config.fuser,
    )


def snr_sweep(flight: Flight, snr_db: Sequence[float], seeds: Sequence[int]) -> pd.DataFrame:
    """One row per ratio and seed, RMSE against the truth in the channel's unit.

    Columns: `snr_db`, `seed`, `noise_sd`; `raw`, `fused` and `free_run` (the model alone);
    `fed_raw` and `fed_fused`, the network's one-step prediction from either history; `mean_nis`
    with its 95 % bounds `nis_low` and `nis_high`. R and Q are estimated from each noisy signal;
    nothing is tuned, and the ratio is not used.
    """
    return pd.DataFrame(
        {"snr_db": snr, "seed": seed, **_trial(flight, (snr, seed))}
        for snr in snr_db
        for seed in seeds
    )


def summarise(sweep: pd.DataFrame) -> pd.DataFrame:
    """Per ratio: means over the seeds."""
    return sweep.drop(columns="seed").groupby("snr_db", sort=True).mean().reset_index()


def noisy(truth: FloatArray, setting: tuple[float, int]) -> tuple[FloatArray, float]:
    """Add noise at `setting` (ratio in dB, seed) to `truth` `(time,)`; also its deviation."""
    snr_db, seed = setting
    # A stream per ratio: the same seed at two ratios must not give the same noise twice.
    rng = np.random.default_rng([seed, round(10 * snr_db) % 2**32])
    strength = np.mean(truth[np.isfinite(truth)] ** 2)
    deviation = float(np.sqrt(strength / 10.0 ** (snr_db / 10.0)))
    return np.asarray(truth + deviation * rng.normal(size=truth.shape)), deviation


def _trial(flight: Flight, setting: tuple[float, int]) -> dict[str, float]:
    truth, free_run = flight.truth[:, flight.at], flight.free_run[:, flight.at]
    measured, deviation = noisy(truth, setting)
    run = flight.fused(measured)
    fused, check = run.values[:, 0], run.consistency()  # noqa: PD011 -- no data frame
    return {
        "noise_sd": deviation,
        "raw": rms(measured - truth),
        "fused": rms(fused - truth),
        "free_run": rms(free_run - truth),
        "fed_raw": flight.fed(measured),
        "fed_fused": flight.fed(fused),
        "mean_nis": check.mean_nis,
        "nis_low": check.low,
        "nis_high": check.high,
    }


def noise(
    data: DataSets,
    bundle: Bundle,
    effort: Effort,
    progress: Progress = silent,
) -> Study:
    """Sweep the noise over the paper's data sets; one seed where the effort is cut."""
    channel, seeds = data.speeds[-1], (0,) if effort.iterations else (0, 1, 2)
    found: dict[str, pd.DataFrame] = {}
    logs = numbered(data, NOISE_SETS)
    flights = [flight_of(data, bundle, log) for log in logs]
    for count, (log, flight) in enumerate(zip(logs, flights, strict=True)):
        progress(count, len(logs))
        found[data.label(log.name)] = summarise(snr_sweep(flight, SNR_DB, seeds))
    sweeps = [NoiseSweep(f"Data set {name}", channel, table) for name, table in found.items()]
    return Study(
        key="noise",
        title=f"{symbol(channel)} with noise below 45 dB",
        source="section 3.3 and conclusion (3), figure 13",
        text=f"Gaussian noise is added to the smoothed {symbol(channel)}; the Kalman fuser "
        "merges it with the model's free run; the network is then fed a step at a time with either "
        "as its past. Errors are against the smoothed signal. Noise variances are estimated from "
        "the noisy signal; the ratio is not used.",
        claims=_claims(found),
        tables=[tables.noise(sweep) for sweep in sweeps],
        pictures=[
            *(figures.noise(sweep) for sweep in sweeps[:1]),
            _excerpt(data, logs[0], flights[0]),
        ],
        results={
            "channel": channel,
            "data_sets": {name: _rows(table) for name, table in found.items()},
        },
    )


def share_better(found: Mapping[str, pd.DataFrame], better: str, worse: str) -> float:
    """Share in percent of data sets and ratios at which one mean RMSE is below the other."""
    every = pd.concat(list(found.values()))
    return 100.0 * float((every[better] < every[worse]).mean())


def _claims(found: Mapping[str, pd.DataFrame]) -> list[Claim]:
    claims = []
    for key, better, worse in (
        ("fed", "fed_fused", "fed_raw"), ("fused", "fused", "raw"),
        ("free_run", "fused", "free_run"),
    ):  # fmt: skip
        share = share_better(found, better, worse)
        remark = "" if share >= 100.0 else _lost(found, better, worse)
        claims.append(claim("narx-paper", key, share, remark=remark))
    return claims


def _lost(found: Mapping[str, pd.DataFrame], better: str, worse: str) -> str:
    places = [
        f"{name} at {ratio:g} dB"
        for name, table in found.items()
        for ratio in table.loc[~(table[better] < table[worse]), "snr_db"]
    ]
    return f"not so: {', '.join(places)}"


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    kept = ["snr_db", "noise_sd", *CURVES, "mean_nis"]
    return [{str(k): v for k, v in row.items()} for row in table[kept].to_dict(orient="records")]


def _excerpt(data: DataSets, log: Log, flight: Flight) -> Picture:
    """Some seconds round the first event, at one ratio: figure 13."""
    truth = flight.truth[:, flight.at]
    measured, _ = noisy(truth, (SHOWN_DB, 0))
    fused = flight.fused(measured).values[:, 0]  # noqa: PD011 -- no data frame
    curves = {"with noise": measured, "fused": fused, "smoothed": truth}
    rows = _shown(data, log)
    caption = f"Data set {data.label(log.name)} at {SHOWN_DB:g} dB."
    shown = {name: values[rows] for name, values in curves.items()}
    return figures.fused(log.time_s[rows], flight.channel, shown, caption)


def _shown(data: DataSets, log: Log) -> slice:
    events: Sequence[Any] = data.prepared[data.number(log.name) - 1].events
    start = events[0].start if events else 0
    return slice(max(0, start - round(2.0 / log.dt_s)), start + round(_SHOWN_S / log.dt_s))
