"""Section 3.3 of the paper: N2 with strong noise, fused with the model, fed to the network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from data_prep.log import Log
from eval.denoising import CURVES, Flight, SweepConfig, flight_of, noisy, snr_sweep, summarise
from eval.report import paper_figures, study_figures, tables
from eval.report.building import noise_curves
from eval.report.claims import Claim, Study
from eval.report.style import symbol
from eval.report.svg import Picture
from eval.reproduce.data_sets import DataSets, numbered
from eval.reproduce.effort import Effort
from narxcal.bundle import Bundle
from narxcal.fuser import estimate_noise
from narxcal.fuser_fast import FastFuser

PAPER_SETS = (2, 9, 10)
SNR_DB = (25.0, 30.0, 35.0, 40.0, 44.0)  # all below the paper's 45 dB
SHOWN_DB = 35.0
_SHOWN_S = 20.0


def noise(
    data: DataSets,
    bundle: Bundle,
    effort: Effort,
    watch: Callable[[int, int], None] | None = None,
) -> Study:
    """Sweep the noise over the paper's data sets."""
    config = sweep_config(data, effort)
    found: dict[str, pd.DataFrame] = {}
    logs = numbered(data, PAPER_SETS)
    for count, log in enumerate(logs):
        if watch is not None:
            watch(count, len(logs))
        found[data.label(log.name)] = summarise(snr_sweep(flight_of(bundle, log), config))
    sweeps = [
        noise_curves(f"Data set {name}", config.channel, table, CURVES)
        for name, table in found.items()
    ]
    return Study(
        key="noise",
        title=f"{symbol(config.channel)} with noise below 45 dB",
        source="section 3.3 and conclusion (3), figure 13",
        text=f"Gaussian noise is added to the smoothed {symbol(config.channel)}; the Kalman fuser "
        "merges it with the model's free run; the network is then fed a step at a time with either "
        "as its past. Errors are against the smoothed signal. Noise variances are estimated from "
        "the noisy signal; nothing knows the ratio.",
        claims=_claims(found),
        tables=[tables.noise(sweep) for sweep in sweeps],
        pictures=[
            *(study_figures.noise(sweep) for sweep in sweeps[:1]),
            _excerpt(data, logs[0], flight_of(bundle, logs[0]), config),
        ],
        results={
            "channel": config.channel,
            "data_sets": {name: _rows(table) for name, table in found.items()},
        },
    )


def sweep_config(data: DataSets, effort: Effort) -> SweepConfig:
    """N2 (the last speed there is); fewer seeds where the effort is cut."""
    seeds = (0,) if effort.iterations else (0, 1, 2)
    channel = data.speeds[-1]
    return SweepConfig(channel=channel, snr_db=SNR_DB, seeds=seeds, fuser=data.config.fuser)


def share_better(found: Mapping[str, pd.DataFrame], better: str, worse: str) -> float:
    """Share in percent of data sets and ratios at which one mean RMSE is below the other."""
    every = pd.concat(list(found.values()))
    return 100.0 * float((every[better] < every[worse]).mean())


def _claims(found: Mapping[str, pd.DataFrame]) -> list[Claim]:
    ratios = "Signal-to-noise ratios and data sets at which "
    pairs = (
        ("the network fed with the fused signal is nearer to the truth than fed with the noisy one",
         "paper", "fed_fused", "fed_raw"),
        ("the fused signal is nearer to the truth than the noisy one", "paper", "fused", "raw"),
        ("the fused signal is nearer to the truth than the free run", "our goal", "fused",
         "free_run"),
    )  # fmt: skip
    claims = []
    for words, origin, better, worse in pairs:
        share = share_better(found, better, worse)
        claims.append(
            Claim(
                what=ratios + words,
                origin=origin,
                claimed="all",
                value=share,
                bound=100.0,
                unit="%",
                below=False,
                remark="" if share >= 100.0 else _lost(found, better, worse),
            )
        )
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
    rows: list[dict[str, Any]] = [
        {str(key): float(value) for key, value in row.items()}
        for row in table[kept].to_dict(orient="records")
    ]
    return rows


def _excerpt(data: DataSets, log: Log, flight: Flight, config: SweepConfig) -> Picture:
    """Some seconds round the first event, at one ratio: figure 13."""
    at = flight.names.index(config.channel)
    truth, free_run = flight.truth[:, at], flight.free_run[:, at]
    measured = noisy(truth, (SHOWN_DB, config.seeds[0]), config.power)
    estimated = estimate_noise(measured, free_run, flight.dt_s, (config.channel,))
    run = FastFuser(estimated, config.fuser).run(free_run[:, None], measured[:, None])
    curves = {"with noise": measured, "fused": run.values[:, 0], "smoothed": truth}  # noqa: PD011
    rows = _shown(data, log)
    caption = f"Data set {data.label(log.name)} at {SHOWN_DB:g} dB."
    shown = {name: values[rows] for name, values in curves.items()}
    return paper_figures.fused(log.time_s[rows], config.channel, shown, caption)


def _shown(data: DataSets, log: Log) -> slice:
    events: Sequence[Any] = data.prepared[data.number(log.name) - 1].events
    start = events[0].start if events else 0
    return slice(max(0, start - round(2.0 / log.dt_s)), start + round(_SHOWN_S / log.dt_s))
