"""A qualification test guide: which events are its tests, their results, and its JSON document.

A test is one event of `eval.judging.log_evaluation`, with the same assessments to the last digit.
What is chosen, titled and annotated stands in a TOML or CSV file of tests (`TestsFile`);
`start_file` writes one of all events found. A `Guide` that was saved is the master of later,
recurrent evaluations.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field

from data_prep.events import AUTO, find_events
from data_prep.log import Log
from eval.judging.free_run import MODEL
from eval.judging.log_evaluation import LogEvaluation, assess_log, overlay_of
from eval.report.view import LogView
from eval.run_logs import run_config
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.folder import seal
from narxcal.channels import described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, did_you_mean
from narxcal.support.files import finite, versions
from narxcal.support.settings import Section, in_toml, read_toml
from training.responses.rules import Manoeuvre, Rules
from training.responses.transients import AssessedEvent, Assessment, TransientsConfig, assessed

SCHEMA: Final = "narxcal.qtg/1"
TESTS_SCHEMA: Final = "narxcal.qtg_tests/1"
WORDS: Final = {True: "PASS", False: "FAIL", None: "NOT ASSESSED"}
_DIGITS = 6  # of a curve in the document: beyond what any recorder resolves
# Preferred as the measure of propulsive force, if the model gives them and they are judged.
_CRITICAL = ("EPR", "N1_pct", "N2_pct")


class FrontMatter(Section):
    """Table [document]: what the cover says; an empty entry is a line to be filled in by hand."""

    device: str = ""
    aeroplane: str = ""
    engine: str = ""
    data_reference: str = ""
    sponsor: str = ""
    authority: str = ""
    revision: str = ""
    place: str = ""
    date: str = ""


class Entry(Section):
    """One [[test]]: the event of `log` that begins at `start_s`, and what its sheet says of it.

    A test without a `number` takes the next of its paragraph. `configuration` names what no log of
    an engine holds: flaps, gear, weight, centre of gravity.
    """

    log: str
    start_s: float
    use: bool = True
    number: str = ""
    title: str = ""
    configuration: str = ""
    rationale: str = ""


class TestsFile(Section):
    """A file of tests; `critical` is the channel that decides, the usual one where empty."""

    __test__ = False  # no test of pytest

    schema_: Literal["narxcal.qtg_tests/1"] = Field(default=TESTS_SCHEMA, alias="schema")
    critical: str = ""
    document: FrontMatter = FrontMatter()
    test: tuple[Entry, ...] = ()


def read_tests(file: Path) -> TestsFile:
    """Read a TOML file of tests, or a CSV with the keys of [[test]]; raises `ConfigError`."""
    table = {"test": _rows(file)} if file.suffix == ".csv" else read_toml(file, TESTS_SCHEMA)
    found = TestsFile.parse(table, file)
    if not found.test:
        raise ConfigError(
            "no [[test]] is listed", file=file, hint="Write a first version by --write-tests"
        )
    return found


def _rows(file: Path) -> list[dict[str, str]]:
    """Rows of a CSV without their empty cells."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=file) from None
    except UnicodeDecodeError:
        raise ConfigError("expected a CSV file, found no text in UTF-8", file=file) from None
    rows = csv.DictReader(io.StringIO(text), restkey="more cells than the header")
    return [{key: cell for key, cell in row.items() if cell} for row in rows]


@dataclass(frozen=True)
class MasterTest:
    """The same event in the master: its number, results by channel and simulated curves."""

    number: str
    rows: Mapping[str, Mapping[str, Any]]
    curves: Mapping[str, Any]

    def curve(self, name: str) -> tuple[FloatArray, FloatArray] | None:
        """Time in seconds on the log's clock and the simulated channel; None without it."""
        if name not in self.curves["model"]:
            return None
        values = np.array(self.curves["model"][name], dtype=np.float64)  # null is NaN
        steps = np.arange(len(values), dtype=np.float64)
        return self.curves["from_s"] + self.curves["dt_s"] * steps, values


@dataclass(frozen=True)
class Master:
    """A guide that was saved before, by the identity of its events."""

    file: str
    model_sha256: str
    rules: str
    tests: Mapping[tuple[str, str, float], MasterTest]


def read_master(file: Path) -> Master:
    """Read `qtg.json` of an earlier run; raises `DataError` for another, or an altered, file."""
    hint = "Name a qtg.json that narxcal qtg wrote"
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror}", file=file, hint=hint) from None
    except (ValueError, RecursionError):
        raise DataError("expected JSON, found something else", file=file, hint=hint) from None
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        raise DataError(f"expected schema '{SCHEMA}', found {schema!r}", file=file, hint=hint)
    if document.pop("sha256", None) != seal(document):
        raise DataError("the file was altered or cut off: its sha256 differs", file=file, hint=hint)
    try:
        tests = {
            _identity(one["sha256"], one["log"], one["start_s"]): MasterTest(
                one["number"], {row["channel"]: row for row in one["results"]}, one["curves"]
            )
            for one in document["tests"]
        }
        return Master(str(file), document["model_sha256"], document["rules"]["name"], tests)
    except (KeyError, TypeError) as error:
        problem = f"a part is missing or of a wrong type ({error})"
        raise DataError(problem, file=file, hint=hint) from None


def _identity(sha256: str, log: str, start_s: float) -> tuple[str, str, float]:
    """What makes two tests the same event: the bytes of the file, the engine, the time."""
    return sha256, log.rpartition(":")[2] if ":" in log else "", round(start_s, 3)


@dataclass(frozen=True, eq=False)
class Found:
    """An event of a log, judged by the rules; `recorded` is the log before smoothing."""

    view: LogView
    one: AssessedEvent
    recorded: Log | None
    rules: Rules

    @property
    def at(self) -> tuple[str, float]:
        """Log and time in seconds, by which a file of tests names it."""
        return self.view.log.name, self.one.event.start_s

    @property
    def identity(self) -> tuple[str, str, float]:
        return _identity(self.view.log.source.sha256, *self.at)

    @property
    def manoeuvre(self) -> Manoeuvre:
        return self.rules.manoeuvres[self.one.event.label]

    @property
    def usual_title(self) -> str:
        log, event = self.view.log, self.one.event
        when = log.moment(event.start_s, decimals=2)
        return f"{self.manoeuvre.title}, {event.speed}, {log.name} at {when}"

    @property
    def condition_met(self) -> bool | None:
        """In approach where that is recorded, or on the ground; None if it has to be confirmed."""
        log, start, ground = self.view.log, self.one.event.start, self.manoeuvre.ground
        if ground is None:
            return True
        wow = float(log["WOW"][start]) if "WOW" in log.channels else math.nan
        if not math.isfinite(wow):
            return None
        if (wow == 1.0) is not ground:
            return False
        approach = "Approach" in log.channels and log["Approach"][start] == 1.0
        return True if ground or approach else None

    def result_by(self, deciding: Sequence[str]) -> bool | None:
        """Whether every deciding channel that could be assessed passes; None if none could."""
        found = tuple(each for each in self.one.assessments if each.channel in deciding)
        return AssessedEvent(self.one.event, found).ok

    def reason(self, deciding: Sequence[str]) -> str:
        """Why it is no test by itself; empty where it is one."""
        event, how = self.one.event, self.manoeuvre
        if event.speed != "fast":
            return f"the movement is {event.speed}"
        if self.condition_met is False:
            return f"flown elsewhere than {how.number} requires ({how.condition})"
        if self.result_by(deciding) is None:
            reasons = [e.verdict.reason for e in self.one.assessments if e.channel in deciding]
            return reasons[0] or "" if reasons else "no deciding channel is recorded"
        return ""


@dataclass(frozen=True, eq=False)
class Test(Found):
    """One sheet: an event with its entry of the file of tests and its number."""

    __test__ = False  # no test of pytest

    entry: Entry
    number: str
    deciding: tuple[str, ...]
    master: MasterTest | None = None

    @property
    def title(self) -> str:
        return self.entry.title or self.usual_title

    @property
    def result(self) -> bool | None:
        return self.result_by(self.deciding)

    @property
    def otherwise(self) -> bool | None:
        """Result by the other reading of an unresolved tolerance; None where that is the same."""
        found = [one.verdict.otherwise for one in self.one.assessments
                 if one.channel in self.deciding]  # fmt: skip
        return next((ok for ok in found if ok is not None), None)

    def row(self) -> dict[str, Any]:
        """One entry of `tests` in `qtg.json`; `results` are rows of `evaluate.json`."""
        view, event = self.view, self.one.event
        rows, log = view.rows(event), view.log
        return {
            "number": self.number,
            "title": self.title,
            "paragraph": self.manoeuvre.number,
            "log": log.name,
            "file": log.source.file,
            "sha256": log.source.sha256,
            "start_s": event.start_s,
            "stop_s": float(log.time_s[event.stop - 1]),
            "condition_met": self.condition_met,
            "initial": dict(view.conditions(event)),
            "result": WORDS[self.result],
            "other_reading": None if self.otherwise is None else WORDS[self.otherwise],
            "deciding": list(self.deciding),
            "configuration": self.entry.configuration,
            "rationale": self.entry.rationale,
            "master": None if self.master is None else self.master.number,
            "results": [each.row() for each in self.one.assessments],
            "curves": {
                "from_s": float(log.time_s[rows.start]),
                "dt_s": log.dt_s,
                "model": {
                    each.name: [float(f"{value:.{_DIGITS}g}") for value in each.model]
                    for each in view.curves(rows)
                    if each.model is not None
                },
            },
        }


@dataclass(frozen=True, eq=False)
class Guide:
    """The whole guide: tests in their order, and every event that is no test, with its reason."""

    bundle: Bundle
    run: str
    front: FrontMatter
    settings: TransientsConfig
    deciding: tuple[str, ...]
    logs: tuple[LogEvaluation, ...]
    tests: tuple[Test, ...]
    left_out: tuple[tuple[Found, str], ...]
    master: Master | None = None
    cautions: tuple[str, ...] = ()

    @property
    def rules(self) -> Rules:
        return self.settings.rule_set

    @property
    def ok(self) -> bool:
        """Whether every test passes; one that could not be assessed is not shown to."""
        return all(test.result is True for test in self.tests)

    @property
    def counts(self) -> dict[str, int]:
        found = Counter(WORDS[test.result] for test in self.tests)
        return {word: found[word] for word in WORDS.values()}

    @cached_property
    def not_repeated(self) -> tuple[str, ...]:
        """Numbers of the master's tests that are none here."""
        if self.master is None:
            return ()
        here = [test.master for test in self.tests]
        return tuple(one.number for one in self.master.tests.values() if one not in here)

    def document(self) -> dict[str, Any]:
        """`qtg.json`, with the hash of all else in it."""
        used = self.rules
        document = finite({
            "schema": SCHEMA,
            "ok": self.ok,
            "counts": self.counts,
            "rules": {
                "name": used.name,
                "source": used.source,
                "tt_origin": used.tt_origin,
                "data_source": self.settings.data_source,
                "clauses": [{"subject": one.subject, "text": one.text, "mark": one.mark}
                            for one in used.clauses],
            },
            "run": self.run,
            "model_sha256": self.bundle.sha256,
            "versions": versions(),
            "document": self.front.model_dump(),
            "master": None if self.master is None else {
                "file": self.master.file,
                "model_sha256": self.master.model_sha256,
                "not_repeated": list(self.not_repeated),
            },
            "free_run_rmse": {one.log.name: {name: each.rmse for name, each in one.scores.items()}
                              for one in self.logs},
            "tests": [test.row() for test in self.tests],
            "left_out": [
                {"log": found.at[0], "start_s": found.at[1], "move": found.one.move, "reason": why}
                for found, why in self.left_out
            ],
            "cautions": list(self.cautions),
        })  # fmt: skip
        return {"schema": SCHEMA, "sha256": seal(document), **document}


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Logs that a bundle was run over, with every event on them, in flight and on the ground."""

    bundle: Bundle
    settings: TransientsConfig
    logs: tuple[LogEvaluation, ...]
    found: tuple[Found, ...]

    def deciding(self, critical: str = "") -> tuple[str, ...]:
        """Channels whose verdict is the result of a test; raises `ConfigError`."""
        outputs = self.bundle.calibration.output_names
        judged = [name for name in self.settings.channels if name in outputs]
        if critical and critical not in judged:
            raise ConfigError(
                "the critical channel is not judged by the run",
                channel=critical,
                hint=f"Name one of {', '.join(judged)}, or judge it by [evaluate.transients]",
            )
        if critical or not self.settings.rule_set.one_decides:
            return (critical,) if critical else tuple(judged)
        return tuple([name for name in _CRITICAL if name in judged] or judged)[:1]


def evaluate_events(
    bundle: Bundle, logs: Sequence[Log], settings: TransientsConfig, recorded: Sequence[Log] = ()
) -> Evaluated:
    """Evaluate prepared logs; `recorded` are the same before smoothing.

    Raises as `eval.judging.log_evaluation.assess_log`.
    """
    config, judged = run_config(bundle)
    judged, rules = judged.model_copy(update={"transients": settings}), settings.rule_set
    raw = {log.name: log for log in recorded}
    parts, found = [], []
    for log in logs:
        part = assess_log(bundle, log, judged)
        driver, own = config.events.driver, raw.get(log.name)
        view = LogView(log=part.log, driver=driver, outputs=part.run.channels, evaluation=part)
        own = own if own is not None and len(own) == len(log) else None
        parts.append(part)
        events = sorted((*part.events, *_elsewhere(part, bundle, settings)),
                        key=lambda one: one.event.start)  # fmt: skip
        found += [Found(view, one, own, rules) for one in events]
    return Evaluated(bundle, settings, tuple(parts), tuple(found))


def _elsewhere(
    part: LogEvaluation, bundle: Bundle, settings: TransientsConfig
) -> tuple[AssessedEvent, ...]:
    """Events on the ground, which `evaluate` leaves out and paragraph 1.f.2 requires."""
    events = run_config(bundle)[0].events
    if events.condition not in (AUTO, "WOW") or "WOW" not in part.log.channels:
        return ()
    other = events.model_copy(
        update={"condition": "WOW", "condition_value": 1.0 - events.condition_value}
    ).for_log(part.log, bundle.calibration.output_names)
    return assessed(find_events(part.log, other), overlay_of(part.run, MODEL), settings)


def guide_of(
    events: Evaluated,
    run: str,
    listed: TestsFile | None = None,
    file: Path | None = None,
    master: Master | None = None,
) -> Guide:
    """Make the guide of the run of that name, by the tests `listed` in `file`.

    Without them every fast movement that can be assessed is a test. Raises `ConfigError` for tests
    that are no events, and `DataError` for a master of other events.
    """
    tests_file = listed or TestsFile(document=FrontMatter())
    deciding = events.deciding(tests_file.critical)
    used = events.settings.rule_set
    named, others = _chosen(events, deciding, file, tests_file.test)
    tests = tuple(
        Test(found.view, found.one, found.recorded, used, entry, number, deciding,
             master.tests.get(found.identity) if master else None)
        for found, entry, number in _numbered(named, used, file)
    )  # fmt: skip
    if master is not None and master.rules != used.name:
        raise DataError(
            f"its times are by the rules '{master.rules}', these by '{used.name}'",
            file=master.file,
            hint=f"Add --rules {master.rules}",
        )
    if master is not None and not any(test.master for test in tests):
        raise DataError(
            "none of its tests is one of these events",
            file=master.file,
            hint="Name the master's own logs by --logs",
        )
    return Guide(events.bundle, run, tests_file.document, events.settings, deciding, events.logs,
                 tests, tuple(others), master)  # fmt: skip


def _chosen(
    events: Evaluated, deciding: Sequence[str], file: Path | None, listed: Sequence[Entry]
) -> tuple[list[tuple[Found, Entry]], list[tuple[Found, str]]]:
    """Divide the events into tests with their entries, and others with the reason.

    Without `file`, every fast movement that can be assessed is a test. Raises `ConfigError` for an
    entry of no event, two of the same, and where nothing is left.
    """
    found = events.found
    if file is None:
        named = [(one, _entry(one, use=not one.reason(deciding))) for one in found]
    else:
        named = _matched(found, file, listed)
    tests = [(one, entry) for one, entry in named if entry.use]
    used = {id(one) for one, _ in tests}
    others = [(one, one.reason(deciding) or "not chosen") for one in found if id(one) not in used]
    if not tests:
        why = Counter(reason for _, reason in others).most_common(1)
        most = f" ({len(others)} events; {why[0][0]})" if why else " (no event was found)"
        raise ConfigError(
            f"no event is a test{most}",
            file=file,
            hint="Choose events by use = true in a file of tests, as --write-tests writes one",
        )
    return tests, others


def _entry(one: Found, *, use: bool) -> Entry:
    return Entry(log=one.at[0], start_s=round(one.at[1], 3), use=use)


def _matched(
    found: Sequence[Found], file: Path, listed: Sequence[Entry]
) -> list[tuple[Found, Entry]]:
    named: dict[int, tuple[Found, Entry]] = {}
    for entry in listed:
        own = [one for one in found if one.at[0] == entry.log]
        if not own:
            logs = dict.fromkeys(one.at[0] for one in found)
            hint = did_you_mean(entry.log, logs, "Logs with events:") if logs else None
            raise ConfigError(f"no event is of the log '{entry.log}'", file=file, hint=hint)
        near = min(own, key=lambda one: abs(one.at[1] - entry.start_s))
        if abs(near.at[1] - entry.start_s) > 0.5 * near.view.log.dt_s:
            raise ConfigError(
                f"no event of the log '{entry.log}' begins at start_s = {entry.start_s:.10g}",
                file=file,
                hint=f"The nearest has start_s = {near.at[1]:.3f}",
            )
        if id(near) in named:
            problem = f"the event start_s = {entry.start_s:.10g} of '{entry.log}' is listed twice"
            raise ConfigError(problem, file=file, hint="Keep one")
        named[id(near)] = near, entry
    return list(named.values())


def _numbered(
    tests: Iterable[tuple[Found, Entry]], rules: Rules, file: Path | None
) -> list[tuple[Found, Entry, str]]:
    """Give every test a number: its own, or the next free one of its paragraph."""
    tests = sorted(tests, key=lambda one: one[0].manoeuvre.number)
    own = Counter(entry.number for _, entry in tests if entry.number)
    twice = next((number for number, times in own.items() if times > 1), None)
    if twice is not None:
        raise ConfigError(f"two tests have the number '{twice}'", file=file, hint="Change one")
    running = {one.number: count(1) for one in rules.manoeuvres}
    numbers = []
    for found, entry in tests:
        paragraph = found.manoeuvre.number
        free = (f"{paragraph}-{k:02d}" for k in running[paragraph])
        number = entry.number or next(each for each in free if each not in own)
        numbers.append((found, entry, number))
    return numbers


def start_file(events: Evaluated, file: Path) -> str:
    """Text of `file`, TOML or CSV, with all events; tests by themselves have `use = true`."""
    deciding = events.deciding()
    reasons = [one.reason(deciding) for one in events.found]
    rows = [
        _entry(one, use=not why).model_dump() | {"title": one.usual_title}
        for one, why in zip(events.found, reasons, strict=True)
    ]
    if file.suffix == ".csv":
        text = io.StringIO()
        writer = csv.DictWriter(text, Entry.model_fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()
    lines = [
        f'schema = "{TESTS_SCHEMA}"',
        'critical = ""  # the channel that decides; empty: the usual one of the rules',
        "",
        "[document]  # what the cover says; an empty entry is a line to be filled in by hand",
        *(f'{name} = ""' for name in FrontMatter.model_fields),
    ]
    for row, why in zip(rows, reasons, strict=True):
        lines += ["", "[[test]]" + (f"  # {_plain(why)}" if why else "")]
        lines += [f"{name} = {in_toml(value)}" for name, value in row.items()]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    return "".join(one if one.isprintable() else " " for one in text)


def supporting(test: Test) -> list[Assessment]:
    """Channels that do not decide and whose times are outside of the tolerance."""
    return [one for one in test.one.assessments
            if one.channel not in test.deciding and one.verdict.ok is False]  # fmt: skip


def unit_value(name: str, value: float) -> str:
    """Value of a channel with its unit, as precise as an instrument is read."""
    known = described(name)
    if known.role == "switch":
        return "on" if value else "off"
    digits = {"ft": 0, "-": 3, "kg/h": 0, "kN": 2}.get(known.unit, 1)
    unit = {"degC": " °C", "deg": "°", "-": ""}.get(known.unit, f" {known.unit}")
    return f"{round(value, digits) + 0.0:.{digits}f}{unit}"  # never -0.0
