"""The pages of a qualification test guide: front matter, then one sheet a test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import PurePath
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from eval.qtg import WORDS, Guide, Test, supporting, unit_value
from eval.report import style
from eval.report.event_figures import draw_output
from eval.report.pdf import (
    BODY,
    INK,
    LEFT,
    QUIET,
    RIGHT,
    SMALL,
    Column,
    Page,
    line_mm,
    to_pdf,
    wrapped,
)
from narxcal.channels import described, symbol
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.files import versions
from training.config import RunConfig
from training.responses.rules import TimeCheck
from training.responses.transients import Assessment

_PLOT_LEFT, _LEAST_PLOTS = 34.0, 60.0  # mm
_RECORDED, _MASTER = "#8c959f", style.BAD
_BLANK = " "
_USES = {"train": "training", "validate": "choice", "test": "tests"}
_COLOURS = {True: style.GOOD, False: style.BAD, None: QUIET}
_LEGEND = {
    "flight": "flight", "as recorded": "flight, as recorded", "model": "simulation",
    "master": "master", "Ti window": "window of simulated 10 %",
    "Tt window": "window of simulated 90 %", "masked": "masked",
}  # fmt: skip
_INDEX = (
    Column("test", 20.0), Column("title", 83.0), Column("condition", 20.0),
    Column("result", 26.0), Column("page", 12.0, "right"), Column("initials", 14.0, "center"),
)  # fmt: skip


def guide_pdf(guide: Guide) -> bytes:
    """Return the guide as a PDF; raises `ConfigError` for a rationale that has no room."""
    # The index names the pages of the sheets, and its own length shifts them.
    front = len(list(_front(guide, 0)))
    pages = chain(_front(guide, front), (_sheet(guide, test) for test in guide.tests))
    return to_pdf(pages, front + len(guide.tests), _title(guide))


def _title(guide: Guide) -> str:
    device = guide.front.device
    return f"Qualification test guide: engine response{f', {device}' if device else ''}"


def _page(guide: Guide, right: str) -> Page:
    made = f"Simulation: product of calibration sha256 {_sha(guide)[:16]}"
    when = ", ".join(filter(None, (guide.front.place, guide.front.date)))
    footer = f"{made}, computed by narxcal {versions()['narxcal']}{f'; {when}' if when else ''}"
    return Page((_title(guide), right), footer)


def _sha(guide: Guide) -> str:
    return guide.bundle.sha256 or "none: not stored"


# --- front matter ---


def _front(guide: Guide, before: int) -> Iterator[Page]:
    """Yield cover, information, statement, rules and index; `before` is how many pages they are."""
    yield _cover(guide)
    yield from _information(guide)
    yield _statement(guide)
    yield from _index(guide, before)
    yield _revisions(guide)


def _cover(guide: Guide) -> Page:
    page, front = _page(guide, "Cover"), guide.front
    page.y = 45.0
    page.heading("Qualification test guide", size=20.0)
    page.heading("Engine response to movements of the power lever: Ti and Tt", size=11.0)
    page.y += 8.0
    names = {"Training device": front.device, "Aeroplane, model and series": front.aeroplane,
             "Engine, model and rating": front.engine, "Sponsor": front.sponsor,
             "Authority": front.authority, "Revision of this guide": front.revision,
             "Where the tests ran": front.place, "When the tests ran": front.date}  # fmt: skip
    for name, value in names.items():
        if value:
            start = page.y
            page.pairs([(name, value)], 55.0, 9.0)
            page.y = max(page.y + 3.5, start + 9.0)
        else:
            page.lines_to_fill([name], 55.0, 9.0)
    page.y += 4.0
    page.pairs([
        ("Rules", guide.rules.source),
        ("Engine model, sha256", _sha(guide)),
        ("Kind of evaluation", _recurrent(guide)),
        ("Tests", ", ".join(f"{number} {word}" for word, number in guide.counts.items())),
    ], 55.0)  # fmt: skip
    page.y += 10.0
    for who in ("For the sponsor", "For the authority"):
        page.heading(who, size=9.0)
        page.lines_to_fill(("Name and position", "Signature", "Date"), 55.0)
    return page


def _recurrent(guide: Guide) -> str:
    if guide.master is None:
        return "initial: no master was given"
    same = guide.master.model_sha256 == guide.bundle.sha256
    model = "the same model" if same else f"a model of sha256 {guide.master.model_sha256[:16]}"
    return f"recurrent: over the master of {model}"


def _information(guide: Guide) -> list[Page]:
    page, record, model = _page(guide, "Information"), guide.bundle.record, guide.bundle.calibration
    config = RunConfig.parse(record.config)
    page.heading("Engine model and its revision")
    page.pairs([
        ("Configuration", config.name),
        ("Revision, sha256", _sha(guide)),
        ("Structure", f"{model.words}; method {record.method}"),
        ("Driven by", ", ".join(map(_named, model.input_names))),
        ("Gives", ", ".join(map(_named, model.output_names))),
        ("Sampling", f"{model.dt_s:g} s"),
        ("Made with", ", ".join(f"{name} {one}" for name, one in record.versions.items())),
        ("Tests computed with", ", ".join(f"{name} {one}" for name, one in versions().items())),
        *((f"Logs for {_USES.get(part, part)}", f"{len(logs)}: {', '.join(logs)}")
          for part, logs in record.split.items() if logs),
    ])  # fmt: skip
    page.heading("Validation data")
    page.paragraph(_treatment(guide, config))
    page.y += 1.5
    columns = (Column("log", 33.0), Column("used for", 14.0), Column("sha256 of the file", 102.0),
               Column("length", 13.0, "right"), Column("masked", 13.0, "right"))  # fmt: skip
    rows = [[one.log.name, one.role, one.log.source.sha256,
             f"{one.log.time_s[-1] - one.log.time_s[0]:.0f} s", str(sum(
                 sum(why.values()) for why in one.log.audit.masked().values()))]
            for one in guide.logs]  # fmt: skip
    pages = _tabled(guide, page, columns, rows)
    page = _with_room(guide, pages, 50.0)
    page.heading("Free run over whole logs")
    page.paragraph(
        "A model that is right only at its test points is not acceptable: root mean square of "
        "simulation minus flight over every sample of the logs, the model fed with nothing but its "
        "inputs."
    )
    page.y += 1.5
    names = model.output_names
    errors = [[one.log.name, *(f"{one.scores[name].rmse:.3g}" for name in names)]
              for one in guide.logs]  # fmt: skip
    shown = [
        Column(style.with_unit(name), min(22.0, 115.0 / len(names)), "right") for name in names
    ]
    return pages[:-1] + _tabled(guide, page, (Column("log", 60.0), *shown), errors)


def _with_room(guide: Guide, pages: list[Page], height: float) -> Page:
    """Return the last page, or a new one where less than `height` mm are free."""
    if pages[-1].room < height:
        pages.append(_page(guide, "continued"))
    return pages[-1]


def _tabled(
    guide: Guide, page: Page, columns: Sequence[Column], rows: Sequence[Sequence[str]]
) -> list[Page]:
    pages, done = [page], page.table(columns, rows)
    while done < len(rows):
        pages.append(_page(guide, "continued"))
        done += pages[-1].table(columns, rows[done:])
    return pages


def _treatment(guide: Guide, config: RunConfig) -> str:
    dt_s = guide.bundle.calibration.dt_s
    window = config.smooth.window_at(dt_s)
    smooth = (
        f"the channels shown in black are centred moving averages of {window} samples "
        f"({window * dt_s:.2g} s), the recorded samples are grey dots"
        if window > 1
        else "nothing was smoothed"
    )
    source = {"flight": "flight test", "engineering": "an engineering simulator"}
    return (
        f"Data of {source[guide.settings.data_source]}, brought to one grid of {1.0 / dt_s:.3g} "
        f"Hz; {smooth}. Lever and switches are as recorded. Samples that are not physical, or at "
        "fault, are masked, counted below and not drawn. No trim, shift in time or scaling is "
        "applied. "
        + (f"Reference: {guide.front.data_reference}." if guide.front.data_reference else "")
    )


def _named(name: str) -> str:
    known = described(name)
    unit = style.unit(name)
    return f"{symbol(name)} ({known.meaning}{f', {unit}' if unit else ''})"


def _statement(guide: Guide) -> Page:
    page, counts, used = _page(guide, "Statement of compliance"), guide.counts, guide.rules
    page.heading("Statement of compliance")
    page.paragraph(
        f"The engine response of the device named on the cover is computed by the calibration of "
        f"sha256 {_sha(guide)}. The tests in this guide, {len(guide.tests)} in all, were run "
        "with it on the recordings listed under validation data, in free run: recorded lever, air "
        "data and switches drive the model, and no output is driven or constrained. "
        f"{counts['PASS']} meet the tolerances of {used.source}, {counts['FAIL']} do not and "
        f"{counts['NOT ASSESSED']} could not be assessed; the rationale of each is on its sheet. "
        "The statement is made by the person who signs it; the software that printed it makes none."
    )
    page.y += 5.0
    page.lines_to_fill(("Name and position", "Signature", "Date"))
    page.heading("Rules, and how far they are verified")
    page.table(
        (Column("subject", 32.0), Column("in our words", 93.0), Column("source", 50.0)),
        [[one.subject, one.text, one.mark] for one in used.clauses],
    )
    page.y += 2.0
    deciding = " and ".join(map(symbol, guide.deciding))
    decide = "decides; other channels support it" if len(guide.deciding) == 1 else "decide"
    page.paragraph(
        f"Tolerances used: Ti {used.Ti}, Tt {used.Tt}, of the flight's time. {deciding} {decide}. "
        f"Tt begins {'at 10 % of the response' if used.tt_origin == 't10' else 'with the lever'}. "
        f"A simulated response of less than {100.0 * used.least_model_share:g} % of the flight's "
        "fails whatever its times are (our own rule)."
    )
    page.heading("Signs, units and terms")
    page.pairs([
        ("Difference", "simulation minus flight: positive is later"),
        ("t = 0", "first movement of the lever; flight and simulation share one clock"),
        ("Settled levels", "of each curve for itself: level errors, see free run, stay apart"),
        *((symbol(name), f"{described(name).meaning}, {style.unit(name) or 'no unit'}")
          for name in (*guide.bundle.calibration.input_names,
                       *guide.bundle.calibration.output_names)),
    ], 32.0, BODY - 0.5)  # fmt: skip
    return page


def _index(guide: Guide, before: int) -> list[Page]:
    page = _page(guide, "Index of tests")
    page.heading("Index of tests and results")
    counts = ", ".join(f"{number} {word}" for word, number in guide.counts.items())
    page.paragraph(f"{counts}. Condition: whether the event was flown where the paragraph asks.")
    page.y += 1.5
    rows = [[test.number, test.title, _condition(test), WORDS[test.result],
             str(before + 1 + k), _BLANK] for k, test in enumerate(guide.tests)]  # fmt: skip
    pages = _tabled(guide, page, _INDEX, rows)
    page = _with_room(guide, pages, 60.0)
    page.heading("Not tested here")
    if guide.not_repeated:
        page.paragraph(f"Tests of the master: {', '.join(guide.not_repeated)}.")
        page.y += 1.5
    if not guide.left_out:
        page.paragraph("Every event found in the logs is a test.")
        return pages
    groups: dict[tuple[str, str, str], list[str]] = {}
    for one, why in guide.left_out:
        groups.setdefault((one.at[0], one.one.move, why), []).append(f"{one.at[1]:.2f}")
    columns = (Column("log", 33.0), Column("movement", 20.0), Column("why", 52.0),
               Column("events, by time [s]", 70.0))  # fmt: skip
    left = [[*key, f"{len(times)}: {', '.join(times)}"] for key, times in groups.items()]
    return pages[:-1] + _tabled(guide, page, columns, left)


def _revisions(guide: Guide) -> Page:
    page = _page(guide, "Log of revisions")
    page.heading("Log of revisions and effective pages")
    page.table((Column("revision", 25.0), Column("date", 30.0), Column("pages", 45.0),
                Column("reason", 50.0), Column("initials", 25.0)), [])  # fmt: skip
    for _ in range(14):
        page.y += 9.0
        page.rule(page.y)
    if guide.cautions:
        page.y += 3.0
        page.heading("Remarks on the data")
        for text in guide.cautions:
            page.paragraph(text)
            page.y += 1.0
    return page


def _condition(test: Test) -> str:
    return {True: "as required", False: "NOT MET", None: "to confirm"}[test.condition_met]


# --- one sheet ---


def _sheet(guide: Guide, test: Test) -> Page:
    page = _page(guide, f"Test {test.number}")
    _head(page, test)
    page.pairs(_facts(guide, test), 32.0, SMALL)
    rationale = wrapped(test.entry.rationale, RIGHT - LEFT - 26.0, BODY)
    rows = _rows(test)
    below = 25.0 + line_mm(BODY) * max(2, len(rationale)) + (line_mm(BODY - 0.5) + 0.5) * len(rows)
    height = page.room - below
    if height < _LEAST_PLOTS:
        raise ConfigError(
            f"the sheet of test '{test.number}' has no room for its texts",
            hint="Shorten its rationale or configuration, and refer to another document",
        )
    _plots(page, test, height)
    _numbers(page, test, rows)
    page.text((LEFT, page.y), "Rationale", color=QUIET)
    page.paragraph(test.entry.rationale or _BLANK, ends=(LEFT + 26.0, RIGHT))
    if not test.entry.rationale:
        page.rule(page.y + 0.5, (LEFT + 26.0, RIGHT))
        page.y += line_mm(BODY)
    page.y = 275.0
    for x, who in ((LEFT, "Engineer"), (LEFT + 60.0, "Quality"), (LEFT + 120.0, "Authority")):
        page.text((x, page.y), f"{who}: initials", size=SMALL, color=QUIET)
        page.rule(page.y + 3.0, (x + 21.0, x + 32.0))
        page.text((x + 33.0, page.y), "date", size=SMALL, color=QUIET)
        page.rule(page.y + 3.0, (x + 39.5, x + 55.0))
    return page


def _head(page: Page, test: Test) -> None:
    # Bold letters are up to 15 % wider than those that the width is computed of.
    for line in wrapped(f"{test.number}  {test.title}", (RIGHT - LEFT - 38.0) / 1.15, 10.5):
        page.text((LEFT, page.y), line, size=10.5, weight="bold")
        page.y += line_mm(10.5)
    colour = _COLOURS[test.result]
    page.box((RIGHT - 34.0, 22.5), (34.0, 7.5), colour)
    page.text((RIGHT - 17.0, 24.6), WORDS[test.result], size=10.0, align="center", weight="bold",
              color=colour)  # fmt: skip
    page.y = max(page.y, 31.0) + 1.0


def _facts(guide: Guide, test: Test) -> list[tuple[str, str]]:
    """Say what a test sheet has to, in the order of 14 CFR Part 60 App. A section 11."""
    view, event, how, reading = test.view, test.one.event, test.manoeuvre, guide.settings
    log, rows, moving = view.log, view.rows(event), ("accelerates", "decelerates")[event.label]
    met = {True: "as required", False: "NOT as required", None: "to be confirmed by the engineer"}
    lever = [unit_value(view.driver, each) for each in (event.lever_before, event.lever_after)]
    engine = f", engine {log.source.engine}" if log.source.engine else ""
    ends = float(log.time_s[rows.start]), float(log.time_s[rows.stop - 1])
    span = log.moment(*ends, decimals=2)
    facts = {
        "Paragraph": f"{how.number} {how.title.lower()}; {guide.rules.source}",
        "Objective": f"Show that the simulated engine {moving} as the aeroplane's does.",
        "Initial conditions": _initial(test),
        "Configuration": test.entry.configuration
        or "flaps, gear, weight and centre of gravity: not part of the engine recording",
        "Flown": f"{symbol(view.driver)} from {lever[0]} to {lever[1]} ({test.one.move}). "
        f"Paragraph: {how.condition}; {how.movement}. Flight condition: {met[test.condition_met]}.",
        "Procedure": "Manual: from the initial conditions move the lever as plotted, record until "
        "settled. Automatic: the recorded inputs drive the model from the log's first sample.",
        "Driven, constrained": _driven(guide, test, rows),
        "Evaluation, tolerances": f"levels: medians over {reading.before_s:g} s before the "
        f"movement and the last {reading.after_s:g} s, crossings {reading.reading}; "
        f"Ti {guide.rules.Ti}; Tt {guide.rules.Tt} of the flight's. {_marks(guide)}",
        "Validation data": f"{PurePath(log.source.file).name}{engine}, {span}, lever moves at "
        f"{log.moment(event.start_s, decimals=2)}; sha256 {log.source.sha256}",
        "Data treatment": f"see Information; samples masked here: {_masked(test, rows)}",
        "Model, revision": f"sha256 {_sha(guide)}",
    }
    return list(facts.items())


def _driven(guide: Guide, test: Test, rows: slice) -> str:
    driven = ", ".join(map(symbol, guide.bundle.calibration.input_names))
    run = None if test.view.evaluation is None else test.view.evaluation.run
    outside = 0.0 if run is None else 100.0 * float(np.mean(~run.in_envelope[rows]))
    where = f"; {outside:.0f} % of samples outside the model's envelope" if outside else ""
    return f"driven: {driven}; constrained: none{where}"


def _marks(guide: Guide) -> str:
    wanted = ("Tolerances", "Ti and Tt")
    marks = [f"{one.subject}: {one.mark}" for one in guide.rules.clauses if one.subject in wanted]
    return "; ".join(marks)


def _initial(test: Test) -> str:
    view, start = test.view, test.one.event.start
    found = [f"{described(name).meaning} {unit_value(name, value)}"
             for name, value in view.conditions(test.one.event).items()]  # fmt: skip
    levels = {each.name: float(each.measured[0]) for each in view.curves(slice(start, start + 1))}
    return ", ".join([
        *found,
        *(f"{symbol(name)} {unit_value(name, value)}" for name, value in levels.items()
          if np.isfinite(value)),
    ])  # fmt: skip


def _masked(test: Test, rows: slice) -> str:
    lost = {
        symbol(each.name): int(np.isnan(each.measured).sum()) for each in test.view.curves(rows)
    }
    return ", ".join(f"{name} {number}" for name, number in lost.items() if number) or "none"


def _plots(page: Page, test: Test, height: float) -> None:
    """Driver, then every output: flight, simulation, master, tolerance windows, Ti and Tt."""
    view, one, top = test.view, test.one, page.y + 6.5
    rows = view.rows(one.event)
    time = view.log.time_s[rows] - one.event.start_s
    shares = np.array([0.55, *(1.0 for _ in view.outputs)])
    gap = 2.2
    heights = shares / shares.sum() * (height - 16.0 - gap * (len(shares) - 1))
    first = page.axes(top, float(heights[0]), _PLOT_LEFT)
    first.plot(time, view.log[view.driver][rows], color=style.DRIVER, lw=1.0)
    first.set_ylabel(style.with_unit(view.driver))
    panels = [first]
    for curves, tall in zip(view.curves(rows), heights[1:], strict=True):
        top += float(heights[len(panels) - 1]) + gap
        axes = page.axes(top, float(tall), _PLOT_LEFT, first)
        _recorded(axes, test, curves.name, (time, rows))
        draw_output(axes, time, replace(curves, steady=None, half_width=None), one)
        _master(axes, test, curves.name)
        _construction(axes, test, one.of(curves.name))
        panels.append(axes)
    for axes in panels:
        style.dress(axes, size=SMALL)
        axes.axvline(0.0, color=QUIET, lw=0.6, ls=":")
        axes.margins(x=0.0, y=0.12)
        axes.tick_params(labelbottom=axes is panels[-1])
        axes.yaxis.set_label_coords(-0.062, 0.5)
    _legend(panels)
    panels[-1].set_xlabel("time after the first movement of the lever [s]", labelpad=1.5)
    page.y = top + float(heights[-1]) + 9.5


def _legend(panels: Sequence[Axes]) -> None:
    """Name every kind of line once, above the driver, where that hides no curve."""
    found: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        found |= dict(zip(labels, handles, strict=True))
    shown = {label: found[label] for label in _LEGEND if label in found}
    panels[0].legend(
        shown.values(), [_LEGEND[label] for label in shown], loc="lower left",
        bbox_to_anchor=(0.0, 1.0), ncols=len(shown), fontsize=SMALL, frameon=False,
        borderaxespad=0.2, handlelength=1.8, columnspacing=1.4, labelcolor=INK,
    )  # fmt: skip


def _recorded(axes: Axes, test: Test, name: str, part: tuple[FloatArray, slice]) -> None:
    time, rows = part
    if test.recorded is not None and name in test.recorded.channels:
        values = test.recorded[name][rows]
        axes.plot(time, values, ".", ms=2.6, mew=0, color=_RECORDED, label="as recorded")


def _master(axes: Axes, test: Test, name: str) -> None:
    found = None if test.master is None else test.master.curve(name)
    if found is not None:
        time, values = found
        style.curve(axes, time - test.one.event.start_s, values, _MASTER, lw=0.9, ls=(0, (4, 2)),
                    label="master")  # fmt: skip


def _construction(axes: Axes, test: Test, one: Assessment | None) -> None:
    """Draw dimension lines of the flight's Ti and Tt where the curves leave room."""
    if one is None or one.flight.reason is not None:
        return
    flight, (low, high) = one.flight, axes.get_ylim()
    from_lever = test.rules.tt_origin == "lever"
    edge, down = (low, -1.0) if flight.response > 0.0 else (high, 1.0)
    step = down * 0.12 * (high - low)
    axes.set_ylim(*sorted((edge + step * (2.4 if from_lever else 1.4), low + high - edge)))
    for name, start_s, stop_s, row in (
        ("Ti", flight.t0_s, flight.t10_s, 0.5),
        ("Tt", flight.t0_s if from_lever else flight.t10_s, flight.t90_s, 0.5 + from_lever),
    ):
        ends = np.array([start_s, stop_s]) - test.one.event.start_s
        at = edge + step * row
        axes.plot(ends, [at, at], color=INK, lw=0.7, marker="|", ms=4.0, mew=0.7)
        # Ti is often too short for its name, which stands before it.
        place, align = (ends[0], "right") if name == "Ti" else (ends.mean(), "center")
        axes.annotate(name, (place, at), (-2.0 if name == "Ti" else 0.0, 1.0), ha=align,
                      textcoords="offset points", size=SMALL - 0.5, color=INK)  # fmt: skip


def _rows(test: Test) -> list[list[str]]:
    """Rows of the table of numbers, with the master's below each channel."""
    rows = []
    for one in test.one.assessments:
        role = "decides" if one.channel in test.deciding else "supports"
        Ti, Tt = one.verdict.Ti, one.verdict.Tt
        rows.append([symbol(one.channel), role, *_times(Ti), *_times(Tt), WORDS[one.verdict.ok]])
        was = None if test.master is None else test.master.rows.get(one.channel)
        if was is not None:
            cells = [_of_master(was, name, now) for name, now in (("Ti", Ti), ("Tt", Tt))]
            result = WORDS[was["ok"]]
            rows.append(["", "master", *chain.from_iterable(cells), result])
    return rows


def _times(check: TimeCheck | None) -> list[str]:
    if check is None:
        return ["-"] * 4
    return [f"{check.flight_s:.3f}", f"{check.model_s:.3f}", f"{check.error_s:+.3f}",
            f"{check.allowed_s:.3f}"]  # fmt: skip


def _of_master(row: Mapping[str, Any], name: str, now: TimeCheck | None) -> list[str]:
    model = row[name]["model"]
    if model is None:
        return ["-"] * 4
    change = "-" if now is None else f"{now.model_s - model:+.3f}"
    return ["", f"{model:.3f}", change, ""]


def _numbers(page: Page, test: Test, rows: Sequence[Sequence[str]]) -> None:
    columns = [Column("channel", 13.0), Column("role", 15.0)]
    for name in ("Ti", "Tt"):
        columns += [Column(f"{name} flight", 15.0, "right"), Column("simulation", 16.0, "right"),
                    Column("difference", 16.0, "right"),
                    Column("allowed ±", 15.0, "right")]  # fmt: skip
    columns.append(Column("result", 23.0, "right"))
    page.table(columns, rows, bold=(len(columns) - 1,))
    page.y += 0.8
    page.paragraph("Times in seconds. " + " ".join(_notes(test)), size=SMALL, colour=QUIET)
    page.y += 1.2


def _notes(test: Test) -> Iterator[str]:
    for one in test.one.assessments:
        if one.verdict.reason:
            yield f"{symbol(one.channel)}: {one.verdict.reason}."
    judged = {one.channel for one in test.one.assessments}
    others = [symbol(name) for name in test.view.outputs if name not in judged]
    if others:
        yield f"{' and '.join(others)}: shown, not judged."
    if test.otherwise is not None:
        yield f"By the other reading of the tolerance of Tt: {WORDS[test.otherwise]}."
    names = [symbol(one.channel) for one in supporting(test)]
    if names:
        yield f"{' and '.join(names)} outside: explain by related variables."
    if test.master is not None:
        yield "Master: its simulation, and this run's minus it."
