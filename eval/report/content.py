"""What goes on a page, as plain records: those who compute fill them, the page only shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import pandas as pd

from data_prep.log import Audit, Source
from eval.residuals import Correlation
from eval.tally import Tally
from eval.transients import Transient, Verdict
from narxcal.support.arrays import FloatArray

if TYPE_CHECKING:
    from data_prep.events import Event


@dataclass(frozen=True, kw_only=True)
class RunHeader:
    """What a qualification page must say about where it comes from.

    `created` is a text such as `2026-11-21 02:05 UTC`; `rules` names the Ti/Tt rule set and
    `tolerances` spells it out; `facts` are further label -> text pairs (split, seeds, hardware,
    command line); `config` is the resolved configuration as text; `cautions` are what a reader has
    to know before the figures.
    """

    title: str
    created: str
    run: str = ""
    model: str = ""
    rules: str = ""
    tolerances: str = ""
    sources: Sequence[Source] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    config: str = ""
    cautions: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelTrace:
    """One output over time, arrays `(time,)` in the channel's unit; NaN where masked."""

    name: str
    measured: FloatArray
    model: FloatArray | None = None
    steady: FloatArray | None = None


@dataclass(frozen=True, kw_only=True)
class Score:
    """Errors of one channel over one log, in the channel's unit unless the name says otherwise.

    `bias` is the mean error; `untrimmed_rmse` that of the same rows before trim.
    `static_rmse` is the part left in quasi-steady samples, `dynamic_rmse` the part in transients;
    `baselines` maps a name (`steady state`, `first order`, `ARX`) to its RMSE on the same samples.
    NaN where a figure does not exist.
    """

    channel: str
    samples: int
    rmse: float
    nrmse: float
    max_rel_pct: float
    one_step_rmse: float = float("nan")
    static_rmse: float = float("nan")
    dynamic_rmse: float = float("nan")
    bias: float = float("nan")
    untrimmed_rmse: float = float("nan")
    baselines: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Response:
    """How flight and model answered one event in one channel, and the verdict on it.

    `model` and `verdict` are None where there is no model (the `prepare` page).
    """

    flight: Transient
    model: Transient | None = None
    verdict: Verdict | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class EventTrace:
    """One event cut out of its log: `time_s` (on the log's clock) and `driver`, both `(time,)`.

    `responses` is keyed by channel; `conditions` holds the initial conditions by canonical
    channel name (`ALT_ft`, `Mach`, ...).
    """

    event: Event
    time_s: FloatArray
    driver: FloatArray
    channels: Sequence[ChannelTrace]
    responses: Mapping[str, Response] = field(default_factory=dict)
    conditions: Mapping[str, float] = field(default_factory=dict)

    @property
    def ok(self) -> bool | None:
        """True if every assessable channel passes, None if no channel is assessable."""
        judged = [
            response.verdict.ok
            for response in self.responses.values()
            if response.verdict is not None and response.verdict.ok is not None
        ]
        return all(judged) if judged else None

    @property
    def severity(self) -> float:
        """Largest error in units of what is allowed; infinite for a failure without times."""
        worst = 0.0
        for response in self.responses.values():
            verdict = response.verdict
            if verdict is None or verdict.ok is None:
                continue
            if verdict.Ti is None or verdict.Tt is None:
                return float("inf")
            for check in (verdict.Ti, verdict.Tt):
                worst = max(worst, abs(check.error_s) / max(check.allowed_s, 1e-9))
        return worst


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTests:
    """Residual of one channel against itself and against each input, lags in samples of `dt_s`."""

    channel: str
    dt_s: float
    auto: Correlation
    cross: Mapping[str, Correlation] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Offsets:
    """Trim offsets added to the model: channel -> one value per power level, in its unit."""

    levels: Sequence[float]
    added: Mapping[str, Sequence[float]]


@dataclass(frozen=True, kw_only=True, eq=False)
class LogPage:
    """Everything about one log; `pearson` has inputs as rows and outputs as columns.

    `role` says what training did with the log. `offsets` were estimated before `scored_from_s`;
    both are None without trim. `tallies` counts Ti/Tt of the model and of each baseline.
    """

    name: str
    time_s: FloatArray
    driver_name: str
    driver: FloatArray
    channels: Sequence[ChannelTrace]
    scores: Sequence[Score] = ()
    events: Sequence[EventTrace] = ()
    residuals: Sequence[ResidualTests] = ()
    pearson: pd.DataFrame | None = None
    audit: Audit = field(default_factory=Audit)
    role: str = ""
    tallies: Mapping[str, Tally] = field(default_factory=dict)
    offsets: Offsets | None = None
    scored_from_s: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowTrial:
    """Moving averages of several widths on one log, as the paper's Fig. 5 compares them.

    `rms` is channel -> window (samples) -> RMS of the smoothed minus the unsmoothed signal;
    `gain` is window -> magnitude response at `frequency_hz` (the closed form for that width).
    `excerpt` shows the same seconds unsmoothed (`0`) and with each window, `(time,)` each.
    """

    log: str
    chosen: int
    rms: Mapping[str, Mapping[int, float]]
    frequency_hz: FloatArray
    gain: Mapping[int, FloatArray]
    excerpt_channel: str = ""
    excerpt_time_s: FloatArray | None = None
    excerpt: Mapping[int, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One column of a cross-validation: `key` into the fold's results, and how to print it."""

    key: str
    label: str
    unit: str = ""
    limit: float | None = None


@dataclass(frozen=True, kw_only=True)
class Fold:
    """One train/test division and what was measured on the test part."""

    name: str
    train: str
    test: str
    results: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """One way of dividing the data (`leave one flight out`, `10 random 7:3 splits by event`)."""

    name: str
    folds: Sequence[Fold]
    measures: Sequence[Measure]
    remark: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseSweep:
    """The denoising experiment: RMSE in the channel's unit against SNR, arrays `(snr,)`.

    `curves` maps a name (`raw measurement`, `fused`, ...) to its RMSE at each SNR; `nis` to the
    mean normalised innovation squared of the filter, with `nis_band` its 95 % bounds.
    """

    log: str
    channel: str
    snr_db: FloatArray
    curves: Mapping[str, FloatArray]
    nis: FloatArray | None = None
    nis_band: tuple[float, float] | None = None
