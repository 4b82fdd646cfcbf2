"""What `narxcal prepare` reports of one log: events, ranking, and what smoothing windows do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from data_prep.cleaning.clean import clean
from data_prep.cleaning.plausibility import checked, of_cleaning
from data_prep.cleaning.smooth import compare_windows, frequency_response, moving_average, smooth
from data_prep.equilibrium import while_running
from data_prep.events import PUSH, Event
from data_prep.log import Log
from data_prep.prepare import LogWarning, Prepared, in_lines
from data_prep.ranking import STRONG, pearson, ranked
from eval.report.tables import WindowTrial
from eval.report.view import LogView
from narxcal.support.errors import DataError
from training.config import RunConfig
from training.responses.transients import AssessedEvent

# The paper compares these, section 2.4.
WINDOWS = (3, 11, 21)
_EXCERPT_S = 12.0
_LEAD_S = 3.0


@dataclass(frozen=True, eq=False)
class LogReport:
    """One prepared log and what was found in it.

    `ranking` has inputs as rows, strongest first, and outputs as columns; `windows` is that of
    `data_prep.cleaning.smooth.compare_windows` on the cleaned log, and `trial` its figure.
    """

    log: Log
    driver: str
    events: tuple[Event, ...]
    warnings: tuple[LogWarning, ...]
    ranking: pd.DataFrame
    windows: pd.DataFrame
    trial: WindowTrial

    def without_samples(self) -> LogReport:
        """What is kept of a log once it is written: thousands of them fit into memory."""
        empty = replace(self.log, time_s=np.empty(0), channels={}, interpolated={})
        return replace(self, log=empty)

    def view(self) -> LogView:
        return LogView(
            log=self.log,
            driver=self.driver,
            outputs=tuple(self.ranking.columns),
            events=[AssessedEvent(event) for event in self.events],
            pearson=self.ranking,
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON: the log in figures, its audit, its events by kind."""
        log = self.log
        return {
            "log": log.name,
            "file": log.source.file,
            "sha256": log.source.sha256,
            "engine": log.source.engine,
            "samples": len(log),
            "dt_s": log.dt_s,
            "duration_s": float(log.time_s[-1] - log.time_s[0]),
            "channels": list(log.channels),
            "audit": [asdict(entry) for entry in log.audit.entries],
            "masked": log.audit.masked(),
            "events": self.counts(),
            "findings": [each.row() for each in log.findings],
            "not_ranked": self.ranking.attrs["reasons"],
        }

    def counts(self) -> dict[str, int]:
        events = self.events
        kinds = {kind: sum(one.speed == kind for one in events) for kind in _SPEEDS}
        return {
            "found": len(events),
            "push": sum(one.label == PUSH for one in events),
            "pull": sum(one.label != PUSH for one in events),
            **kinds,
            "settled": sum(one.settled for one in events),
            "interrupted": sum(one.interrupted for one in events),
        }


_SPEEDS = ("fast", "slow", "small")


def most_to_show(logs: Sequence[LogReport], count: int) -> list[int]:
    """Numbers of the logs with the most warnings, then the most events, in their order."""
    ranked_logs = sorted((-len(one.warnings), -len(one.events), k) for k, one in enumerate(logs))
    return sorted(k for _, _, k in ranked_logs[:count])


def reports(logs: list[Log], config: RunConfig) -> Iterator[LogReport]:
    """Leave out where the engine does not run, and describe what is left as `examine`.

    Empties `logs`, so that no more than one of them takes memory twice.
    """
    running = while_running(logs, config.running)
    logs.clear()
    while running:
        yield examine(running.pop(0), config)


def examine(raw: Log, config: RunConfig) -> LogReport:
    """Clean and smooth `raw` by the tables of `config`, and describe the result.

    Raises `DataError` for a log without the driver or without any of the outputs.
    """
    cleaned = of_cleaning(clean(checked(raw), config.clean))
    del raw  # of a caller that keeps it no longer, too: an hour of a log takes megabytes
    log = smooth(cleaned, config.smooth)
    prepared = Prepared(log, config, config.narx.outputs)
    events = prepared.events
    outputs = [name for name in config.narx.outputs if name in log.channels]
    if not outputs:
        raise DataError(
            f"the log has none of the outputs {', '.join(config.narx.outputs)}",
            file=log.name,
            hint="Map them under [logs.columns], or name others in [narx] outputs",
        )
    window = config.smooth.window_at(log.dt_s)
    sizes = sorted({*WINDOWS, window})
    windows = compare_windows(cleaned, outputs, sizes)
    return LogReport(
        log,
        config.events.driver,
        events,
        prepared.warnings,
        ranking=ranked(pearson(log, _candidates(log, config), outputs)),
        windows=windows,
        trial=_trial(cleaned, events, windows, window),
    )


def cautions_about(logs: Sequence[LogReport]) -> list[str]:
    warned = in_lines(warning for one in logs for warning in one.warnings)
    return [*warned, *(each.caution for one in logs for each in one.log.findings)]


def events_table(logs: Sequence[LogReport]) -> pd.DataFrame:
    events = [event for one in logs for event in one.events]
    columns = [*Event.__dataclass_fields__]
    return pd.DataFrame({name: [getattr(event, name) for event in events] for name in columns})


def pearson_table(logs: Sequence[LogReport]) -> pd.DataFrame:
    """One row per log, input and output: rho, and whether it is strong (|rho| >= 0.8)."""
    rows = [
        {"log": one.log.name, "input": source, "output": target, "rho": rho}
        for one in logs
        for target in one.ranking.columns
        for source, rho in one.ranking[target].items()
    ]
    table = pd.DataFrame(rows, columns=["log", "input", "output", "rho"])
    return table.assign(strong=table["rho"].abs() >= STRONG)


def windows_table(logs: Sequence[LogReport]) -> pd.DataFrame:
    return pd.concat([one.windows.assign(log=one.log.name) for one in logs], ignore_index=True)


def _candidates(log: Log, config: RunConfig) -> list[str]:
    """Channels that may drive the engine: the driver, then the inputs of the model."""
    names = (config.events.driver, *config.steady_state.inputs)
    return [name for name in dict.fromkeys(names) if name in log.channels]


def _trial(
    cleaned: Log, events: Sequence[Event], windows: pd.DataFrame, chosen: int
) -> WindowTrial:
    channel = str(windows["channel"].iloc[0])
    sizes = [int(size) for size in windows["window"].unique()]
    frequency = np.linspace(0.0, 0.5 / cleaned.dt_s, 400)
    rows = _excerpt(cleaned, events)
    values = cleaned[channel]
    smoothed = {size: moving_average(values, size)[rows] for size in sizes}
    return WindowTrial(
        log=cleaned.name,
        chosen=chosen,
        rms={
            str(name): dict(zip(part["window"].tolist(), part["rms"].tolist(), strict=True))
            for name, part in windows.groupby("channel", sort=False)
        },
        frequency_hz=frequency,
        gain={size: frequency_response(size, frequency, cleaned.dt_s) for size in sizes},
        excerpt_channel=channel,
        excerpt_time_s=cleaned.time_s[rows],
        excerpt={0: values[rows], **smoothed},
    )


def _excerpt(log: Log, events: Sequence[Event]) -> slice:
    """Some seconds round the first fast movement, where a window can do harm."""
    ranked = sorted(events, key=lambda event: _SPEEDS.index(event.speed))
    start = ranked[0].start - round(_LEAD_S / log.dt_s) if ranked else 0
    start = max(0, min(start, len(log) - 2))
    return slice(start, start + round(_EXCERPT_S / log.dt_s))
