"""Watch a fleet: how the errors of each engine's model change from flight to flight.

From the dataset of `narxcal fleet`, per tail, engine and output, one value a flight:

| quantity | from | strata |
|---|---|---|
| offset | `trims`: mean of measured minus model in equilibrium | power level |
| lag | `scores`: delay of the model behind the flight | |
| Ti, Tt | `events`: time of the model minus time of the flight | direction and speed |

Flights differ in the power levels and movements that they hold, whose errors differ. So the value
z_f of a flight is its effect next to those of the strata, over cells of c samples each:

    m_fs = z_f + b_s + e_fs,     e_fs ~ N(0, r + u / c_fs),     b_s ~ N(0, variance of strata)

u is the variance of a sample (a minute, a transient) about its cell, r that of cells about
z_f + b_s in excess of it; both are pooled over the fleet. `eval.fleets.drift` finds the changes of
z_f over the flights, which are in the order of their files' names, numbers by value.
"""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from eval.fleets.drift import FALSE_DISCOVERIES, LEAST_FLIGHTS, Change, Drift, Prior, Series, detect
from eval.fleets.fleet import WORK_LIST, read_document, read_table
from eval.fleets.fleet_rows import FAILED, GOOD
from eval.judging.outcome import Outcome, plural
from narxcal.channels import described, symbol
from narxcal.support.addresses import Folder
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.errors import DataError

SCHEMA: Final = "narxcal.watch/1"
QUANTITIES: Final = ("offset", "lag", "Ti", "Tt")
_LOGS = ["tail", "file", "engine", "log"]
_COMPARED = 6  # flights on each side of a change for `diagnose`, which wants three to six


class Flight(NamedTuple):
    """A flight of a tail; `files` engine -> file."""

    name: str
    files: Mapping[str, str]


class Key(NamedTuple):
    """What a series is of."""

    tail: str
    engine: str
    channel: str
    quantity: str

    @property
    def who(self) -> str:
        return f"{self.tail} {self.engine}".strip()

    @property
    def what(self) -> str:
        error = " error" if self.quantity in ("Ti", "Tt") else ""
        return f"{self.quantity}{error} of {symbol(self.channel)}"

    @property
    def unit(self) -> str:
        found = described(self.channel).unit if self.quantity == "offset" else "s"
        return "" if found == "-" else found


@dataclass(frozen=True, eq=False)
class Effects:
    """A series with the numbers of its flights (n,) among those of the tail, and its changes."""

    key: Key
    flights: IntArray
    series: Series
    drift: Drift


@dataclass(frozen=True, eq=False)
class Alarm:
    """Changes of one tail at the same flights, which may have one cause, stated in words.

    `at` names the flight, likeliest of `first` to `last`, and `hours` are those of the tail before
    it; a trend is over all flights. `before` and `after` are files to compare.
    """

    tail: str
    kind: str
    changes: tuple[tuple[Key, Change], ...]
    at: str
    first: str
    last: str
    hours: float
    cause: str
    before: tuple[str, ...]
    after: tuple[str, ...]

    @property
    def engines(self) -> tuple[str, ...]:
        return tuple(sorted({key.engine for key, _ in self.changes}))

    def row(self) -> dict[str, Any]:
        names = ("tail", "kind", "at", "first", "last", "hours", "cause", "before", "after")
        changes = [
            {"engine": key.engine, "channel": key.channel, "quantity": key.quantity,
             "unit": key.unit, **asdict(change)}
            for key, change in self.changes
        ]  # fmt: skip
        return {**{name: getattr(self, name) for name in names}, "changes": changes}


@dataclass(frozen=True, eq=False)
class Watch:
    """What became of a fleet; `flights` tail -> flights in order, `hours` their end (n,).

    `unjudged` are the tails of which no series is long enough.
    """

    flights: Mapping[str, tuple[Flight, ...]]
    hours: Mapping[str, FloatArray]
    effects: tuple[Effects, ...]
    priors: Mapping[tuple[str, str], Prior]
    alarms: tuple[Alarm, ...]
    unjudged: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def outcome(self) -> Outcome:
        """Pass without an alarm; None where a tail has no series that is long enough to judge."""
        total = sum(float(one[-1]) for one in self.hours.values())
        size = f"{plural(len(self.flights), 'tail')}, {total:.1f} flight hours"
        if not self.effects:
            return Outcome(None, f"nothing can be judged: {size}", self.remarks)
        line = (
            f"{len(self.effects)} series judged together; {100 * FALSE_DISCOVERIES:.0f} % of the "
            "changes that are found are expected to be false, at most (Benjamini-Yekutieli)"
        )
        headline = f"{plural(len(self.alarms), 'alarm')} in {size}"
        if self.unjudged:
            headline += f"; {plural(len(self.unjudged), 'tail')} cannot be judged"
        passed = False if self.alarms else None if self.unjudged else True
        return Outcome(passed, headline, (line, *self.remarks))

    def document(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "ok": self.outcome.passed,
            "headline": self.outcome.headline,
            "remarks": list(self.remarks),
            "tails": {
                tail: {"flights": len(flights), "hours": float(self.hours[tail][-1])}
                for tail, flights in self.flights.items()
            },
            "priors": [
                {"channel": name, "quantity": quantity, **asdict(prior)}
                for (name, quantity), prior in self.priors.items()
            ],
            "alarms": [one.row() for one in self.alarms],
            "series": [
                {**one.key._asdict(), "unit": one.key.unit, **_arrays(one)} for one in self.effects
            ],
        }


def _arrays(one: Effects) -> dict[str, Any]:
    arrays = {
        "flight": one.flights, "hours": one.series.hours, "value": one.series.y,
        "standard_error": one.series.errors, "level": one.drift.level,
        "level_error": one.drift.level_error,
    }  # fmt: skip
    return {name: values.tolist() for name, values in arrays.items()}


def watch(dataset: Folder, engine: str | None = None) -> Watch:
    """Find what changed in the fleet of a dataset.

    Group 1 of the regular expression `engine`, searched in a file's name, is the engine of logs
    that name none; files that differ in it alone are one flight. Raises `DataError` for a folder
    that holds no dataset with an evaluated log, `ConfigError` without pyarrow or statsmodels.
    """
    waiting = _check(dataset)
    logs = _with_flights(read_table(dataset, "logs").to_pandas(), engine)
    good = logs[logs["status"] == GOOD]
    if good.empty:
        raise DataError(
            "the dataset has no evaluated log", file=dataset.address,
            hint="Its table logs says why; evaluate some with narxcal fleet",
        )  # fmt: skip
    flights, hours, numbers = _ordered(good)
    found = [
        (key, own, series)
        for quantity, cells in _cells(dataset).items()
        for key, own, series in _series(quantity, cells.merge(numbers, on=_LOGS), hours)
    ]
    drifts, priors = detect(
        [series for *_, series in found], [(key.channel, key.quantity) for key, *_ in found]
    )
    effects = tuple(Effects(*one, drift) for one, drift in zip(found, drifts, strict=True))
    judged = {one.key.tail for one in effects}
    unjudged = tuple(tail for tail in sorted(map(str, logs["tail"].unique())) if tail not in judged)
    remarks = tuple(_remarks(waiting, logs, {tail: len(flights.get(tail, ())) for tail in unjudged},
                             effects))  # fmt: skip
    alarms = _alarms(effects, flights, hours)
    return Watch(flights, hours, effects, priors, alarms, unjudged, remarks)


def _check(dataset: Folder) -> int:
    """Number of batches that are not evaluated yet; raises `DataError` for what is no dataset."""
    read_document(dataset)
    done = len(dataset.sizes(["logs/*/*.parquet"]))
    if not done:
        raise DataError(
            "no batch of logs is evaluated yet", file=dataset.address,
            hint="Go on with narxcal fleet first",
        )  # fmt: skip
    batches = read_table(dataset, WORK_LIST).select(["tail", "batch"]).to_pandas()
    return len(batches.drop_duplicates()) - done


# --- flights ---


def _with_flights(logs: pd.DataFrame, engine: str | None) -> pd.DataFrame:
    """Logs with the `position` of their engine and their `flight`: file without it, and part."""
    position, flight = [], []
    for file, log, own in logs[["file", "log", "engine"]].fillna("").itertuples(index=False):
        match = re.search(engine, file) if engine and not own else None
        position.append(own or (match[1] if match else "") or "")
        name = file if match is None else file[: match.start()] + file[match.end() :]
        part = log.removeprefix(file.rpartition("/")[2]).removeprefix(f":{own}")
        flight.append(name + part)
    return logs.assign(position=position, flight=flight)


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key of a name in which numbers count by value."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)
    ]


def _ordered(
    good: pd.DataFrame,
) -> tuple[dict[str, tuple[Flight, ...]], dict[str, FloatArray], pd.DataFrame]:
    """Tail -> flights and the flight hours at their ends; log -> number of its flight."""
    flights: dict[str, tuple[Flight, ...]] = {}
    hours: dict[str, FloatArray] = {}
    parts = []
    for tail, own in good.groupby("tail", sort=True):
        longest = own.groupby("flight")["hours"].max()
        names = sorted(longest.index, key=_natural)
        files: dict[str, dict[str, str]] = {name: {} for name in names}
        for name, engine, file in zip(own["flight"], own["position"], own["file"], strict=True):
            files[name][engine] = file
        flights[str(tail)] = tuple(Flight(name, files[name]) for name in names)
        hours[str(tail)] = np.cumsum(longest.loc[names].to_numpy(dtype=np.float64))
        number = {name: k for k, name in enumerate(names)}
        parts.append(own[[*_LOGS, "position"]].assign(number=own["flight"].map(number)))
    return flights, hours, pd.concat(parts)


# --- values of flights ---


def _cells(dataset: Folder) -> dict[str, pd.DataFrame]:
    """Quantity -> cells: log, channel, stratum, count, mean, variance of a sample in the cell."""
    trims = read_table(dataset, "trims").to_pandas()
    offset = trims[[*_LOGS, "channel"]].assign(
        stratum=trims["level"].round(6).astype(str), count=trims["minutes"], mean=trims["offset"],
        variance=trims["minutes"] * trims["standard_error"] ** 2,
    )  # fmt: skip
    scores = read_table(dataset, "scores").to_pandas()
    lag = scores[[*_LOGS, "channel"]].assign(
        stratum="", count=1, mean=scores["lag_s"], variance=np.nan
    )
    events = read_table(dataset, "events").to_pandas()
    found = {"offset": offset, "lag": lag}
    for name in ("Ti", "Tt"):
        stratum = events["direction"].astype(str) + " " + events["speed"].astype(str)
        known = events.assign(stratum=stratum).dropna(subset=[f"{name}_error_s"])
        groups = known.groupby([*_LOGS, "channel", "stratum"], dropna=False)[f"{name}_error_s"]
        found[name] = groups.agg(count="size", mean="mean", variance="var").reset_index()
    return {name: cells.dropna(subset=["mean"]) for name, cells in found.items()}


def _series(
    quantity: str, cells: pd.DataFrame, hours: Mapping[str, FloatArray]
) -> Iterator[tuple[Key, IntArray, Series]]:
    """Yield the values of flights of each engine and output that has enough of them."""
    for name, of_channel in cells.groupby("channel", sort=True):
        within = of_channel.dropna(subset=["variance"])
        within = within[within["count"] > 1]
        freedom = within["count"] - 1
        sample = float((freedom * within["variance"]).sum() / max(int(freedom.sum()), 1))
        engines = {
            (str(tail), str(engine)): _Cells.of(own, sample)
            for (tail, engine), own in of_channel.groupby(["tail", "position"], sort=True)
        }
        excess = _excess(list(engines.values()))
        for (tail, engine), own in engines.items():
            if len(own.flights) >= LEAST_FLIGHTS:
                values, errors = own.of_flights(excess)
                ends = hours[tail]
                middle = 0.5 * (ends + np.concatenate([[0.0], ends[:-1]]))[own.flights]
                key = Key(tail, engine, str(name), quantity)
                yield key, own.flights, Series(middle, values, errors)


@dataclass(frozen=True, eq=False)
class _Cells:
    """Means of the cells of one engine and output, their sampling variance, (cells,) each.

    `flight` and `stratum` number them; `flights` (n,) are the numbers of the flights in the tail.
    """

    flights: IntArray
    flight: IntArray
    stratum: IntArray
    mean: FloatArray
    variance: FloatArray

    @classmethod
    def of(cls, own: pd.DataFrame, sample: float) -> _Cells:
        """Number the cells of an engine; `sample` is the variance of a sample in a cell."""
        flights, flight = np.unique(own["number"].to_numpy(dtype=np.int64), return_inverse=True)
        _, stratum = np.unique(own["stratum"].to_numpy(dtype=str), return_inverse=True)
        variance = sample / own["count"].to_numpy(dtype=np.float64)
        return cls(flights, flight, stratum, own["mean"].to_numpy(dtype=np.float64), variance)

    @property
    def tiny(self) -> float:
        """A variance that is none next to those of the cells."""
        return 1e-9 * float(np.var(self.mean)) + 1e-18 * (1.0 + float(np.mean(self.mean**2)))

    def fit(self, variance: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """z_f and its variance (n,), b_s (strata,), for cells of a variance (cells,)."""
        n, strata = len(self.flights), int(self.stratum.max()) + 1
        weights = np.zeros((n, strata))
        np.add.at(weights, (self.flight, self.stratum), 1.0 / variance)
        sums = np.zeros((n, strata))
        np.add.at(sums, (self.flight, self.stratum), self.mean / variance)
        whole, column = weights.sum(axis=1), weights.sum(axis=0)
        share = weights / whole[:, None]
        held = np.bincount(self.stratum, minlength=strata)
        middle = np.bincount(self.stratum, self.mean, strata) / held
        spread = float(np.var(middle)) + float(np.mean(variance))
        normal = np.diag(column) - weights.T @ share + np.eye(strata) / spread
        inverse = np.linalg.inv(normal)
        b = inverse @ (sums.sum(axis=0) - share.T @ sums.sum(axis=1))
        z = sums.sum(axis=1) / whole - share @ b
        # What moves all strata alike moves all flights alike, and is no error of one of them. So
        # errors are those against a mean, and that of the flights that are known well.
        mean = whole / whole.sum()
        for _ in range(2):
            apart = share - mean @ share
            square = 1.0 / whole + np.einsum("fs,st,ft->f", apart, inverse, apart)
            mean = square**-2 / np.sum(square**-2)
        return z, square, b

    def of_flights(self, excess: float) -> tuple[FloatArray, FloatArray]:
        """z_f and its standard error (n,), for r = `excess`; 0 where nothing is known of it."""
        variance = excess + self.variance
        z, square, _ = self.fit(np.maximum(variance, self.tiny))
        return z, np.sqrt(square) if variance.any() else np.zeros(len(z))


def _excess(engines: Sequence[_Cells]) -> float:
    """The r of the module, by moments of the residuals of unweighted fits."""
    square, expected, freedom = 0.0, 0.0, 0
    for own in engines:
        left = len(own.mean) - len(own.flights) - int(own.stratum.max())
        if left < 1:
            continue
        z, _, b = own.fit(np.full(len(own.mean), own.tiny))
        square += float(np.sum((own.mean - z[own.flight] - b[own.stratum]) ** 2))
        expected += left * float(np.mean(own.variance))
        freedom += left
    return max(square - expected, 0.0) / freedom if freedom else 0.0


# --- alarms ---


def _alarms(
    effects: Sequence[Effects],
    flights: Mapping[str, tuple[Flight, ...]],
    hours: Mapping[str, FloatArray],
) -> tuple[Alarm, ...]:
    """Changes in order of significance, those of a tail and kind whose flights overlap together."""
    changes = sorted(
        ((one, change) for one in effects for change in one.drift.changes),
        key=lambda pair: (pair[1].adjusted, pair[0].key, pair[1].at),
    )
    groups: list[list[tuple[Effects, Change]]] = []
    for one, change in changes:
        same = (group for group in groups if _together(group[0], (one, change)))
        group = next(same, None)
        if group is None:
            groups.append([(one, change)])
        else:
            group.append((one, change))
    engines: dict[str, set[str]] = defaultdict(set)
    for one in effects:
        engines[one.key.tail].add(one.key.engine)
    return tuple(
        _alarm(group, flights[tail], hours[tail], len(engines[tail]))
        for group in groups
        for tail in (group[0][0].key.tail,)
    )


def _together(a: tuple[Effects, Change], b: tuple[Effects, Change]) -> bool:
    """Whether two changes may be one: same tail and kind, trends of one engine, common flights."""
    (one, change), (other, further) = a, b
    if (one.key.tail, change.kind) != (other.key.tail, further.kind):
        return False
    if change.kind == "trend":
        return one.key.engine == other.key.engine
    (first, last), (begin, end) = _span(*a), _span(*b)
    return first <= end and begin <= last


def _span(one: Effects, change: Change) -> tuple[int, int]:
    """Numbers of the flights between which the change lies."""
    return int(one.flights[change.first]), int(one.flights[change.last])


def _alarm(
    group: Sequence[tuple[Effects, Change]],
    flights: Sequence[Flight],
    hours: FloatArray,
    engines: int,
) -> Alarm:
    (one, change), *_ = group
    at, kind = int(one.flights[change.at]), change.kind
    first, last = _span(one, change) if kind != "trend" else (0, len(flights) - 1)
    before = flights[max(at - _COMPARED, 0) : at]
    after = flights[at : at + _COMPARED] if kind == "step" else flights[at : at + 1]
    if kind == "trend":
        count = min(_COMPARED, len(flights) // 2)
        before, after = flights[:count], flights[-count:]
    if not before:  # the first flight is the outlier
        before = flights[1 : 1 + _COMPARED]
    changes = tuple((each.key, found) for each, found in group)
    changed = {key.engine for key, _ in changes}
    files = [
        tuple(dict.fromkeys(f for each in part for e, f in each.files.items() if e in changed))
        for part in (before, after)
    ]
    began = float(hours[at - 1]) if at else 0.0
    ends = flights[at].name, flights[first].name, flights[last].name
    return Alarm(one.key.tail, kind, changes, *ends, began, cause(changes, engines), *files)


def cause(changes: Sequence[tuple[Key, Change]], engines: int) -> str:
    """What may have caused changes at the same flights in a tail of so many engines, in words.

    Signs are those of measured minus model at fixed inputs. Wear raises EGT, and fuel where it is
    no input, and moves the speeds that the control does not hold; a wrong reading of the input
    (lever, fuel) moves all outputs one way; that of an output moves it alone.
    """
    moved = {key.channel: np.sign(one.size) for key, one in changes if key.quantity == "offset"}
    slow = {key.channel for key, _ in changes if key.quantity != "offset"}
    if len({key.engine for key, _ in changes}) > 1:
        return (
            "several engines at once: what they share, such as air data, the recorder, the day, or "
            "meters that were calibrated together"
        )
    alone = "" if engines > 1 else " (of a tail with one engine, air data and the day can do it)"
    names = ", ".join(symbol(name) for name in (moved or slow))
    if not moved:
        what = f"the sensor of {names}" if len(slow) == 1 else "rotors, fuel valve or control"
        return f"times alone: {what} became slower or faster{alone}"
    if len(moved) == 1 and not slow - set(moved):
        return (
            f"{names} alone: its sensor or meter, or a change of the engine that is too small to "
            f"show elsewhere{alone}"
        )
    if len(moved) > 1 and len(set(moved.values())) == 1 and "N1_pct" in moved:
        return (
            f"{names} in one direction: the reading of the input (lever or fuel meter), the "
            f"rating, or an exchanged engine{alone}"
        )
    if len(moved) > 1 and "EGT_C" in moved:
        worn = "deterioration" if moved["EGT_C"] > 0 else "a wash, repair or exchanged engine"
        return f"{names} as by a change of the gas path: {worn}{alone}"
    return f"{names}: undetermined, an exchanged engine or its control among others{alone}"


def commands(alarm: Alarm, flights: str = "FLIGHTS", run: str = "RUN") -> tuple[str, ...]:
    """Command lines that diagnose flights before and after an alarm; `run` may hold `{tail}`."""
    found, run = [], run.replace("{tail}", alarm.tail)
    for name, files in (("before", alarm.before), ("after", alarm.after)):
        listed = " ".join(shlex.quote(f"{flights}/{file}") for file in files)
        found += [
            f"mkdir {name} && cp {listed} {name}/",
            f"narxcal diagnose --real {name} --sim {shlex.quote(run)} --out gap-{name}",
        ]
    return tuple(found)


def _remarks(
    waiting: int,
    logs: pd.DataFrame,
    unjudged: Mapping[str, int],
    effects: Sequence[Effects],
) -> Iterator[str]:
    if waiting:
        yield f"{waiting} of the listed batches are not evaluated yet: go on with narxcal fleet"
    failed = int((logs["status"] == FAILED).sum())
    if failed:
        yield f"{plural(failed, 'file')} could not be evaluated (table logs)"
    if unjudged:
        yield f"nothing can be said of tails with fewer than {LEAST_FLIGHTS} judged flights: " + (
            ", ".join(f"{tail} ({plural(own, 'flight')})" for tail, own in unjudged.items())
        )
    judged = {one.key.quantity for one in effects}
    lacking = [name for name in QUANTITIES if name not in judged]
    if lacking and effects:
        yield f"no engine has {LEAST_FLIGHTS} flights with: {', '.join(lacking)}"
