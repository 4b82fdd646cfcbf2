"""The qualification test guide, read back from its PDF and compared with `evaluate`."""

import hashlib
import io
import json
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from pypdf import PdfReader

from eval.judging.evaluate import evaluate
from eval.qtg import evaluate_events, guide_of, read_master, read_tests, start_file
from eval.report.pdf import RIGHT, printable, width_mm, wrapped
from eval.report.qtg_pages import guide_pdf
from narxcal.calibration.folder import seal
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import to_json
from training.responses.transients import TransientsConfig

SHA = "ab" * 32
LOGS = "Name the master's own logs by --logs"
ROOT = Path(__file__).parents[2]


@cache
def evaluated(makers, rules, tau_s, wow, duration_s):
    make_bundle, make_log = makers
    log = make_log(duration_s=duration_s)
    if wow is not None:
        log = log.with_channels({"WOW": np.full(len(log), wow)})
    bundle = replace(make_bundle(tau_s=tau_s), sha256=SHA)
    return evaluate_events(bundle, [log], TransientsConfig(rules=rules), [log])


@cache
def usual(found):
    """The guide of all events, and its PDF."""
    guide = guide_of(found, "run")
    return guide, guide_pdf(guide)


@pytest.fixture
def events(make_bundle, make_log):
    """Makes evaluated events of the lag engine; `wow` is its weight-on-wheels switch."""

    def run(rules="part60", tau_s=(1.5, 0.8), wow=None, duration_s=50.0):
        return evaluated((make_bundle, make_log), rules, tau_s, wow, duration_s)

    return run


def texts(pdf):
    return [page.extract_text() for page in PdfReader(io.BytesIO(pdf)).pages]


def sheet_of(pages, number):
    (found,) = [text for text in pages if text.splitlines() and f"Test {number}\n" in text]
    return found


def test_every_number_on_a_sheet_is_that_of_evaluate(events, make_bundle, make_log):
    guide, pdf = usual(events())
    pages = texts(pdf)
    bundle = make_bundle(evaluate={"transients": {"rules": "part60"}})
    (log,) = evaluate(bundle, [make_log(duration_s=50.0)]).document()["logs"]
    rows = {(row["start_s"], row["channel"]): row for row in log["events"]}
    assert len(guide.tests) == 2
    for test in guide.tests:
        sheet = sheet_of(pages, test.number)
        for channel, role in (("N1_pct", "decides"), ("N2_pct", "supports")):
            row = rows[test.one.event.start_s, channel]
            times = " ".join(
                f"{one['flight']:.3f} {one['model']:.3f} {one['model'] - one['flight']:+.3f} "
                f"{one['allowed']:.3f}"
                for one in (row["Ti"], row["Tt"])
            )
            assert f"{channel[:2]} {role} {times} PASS" in sheet
    document = guide.document()
    assert [one["results"] for one in document["tests"]] == [
        [rows[one["start_s"], name] for name in ("N1_pct", "N2_pct")] for one in document["tests"]
    ]


def test_a_sheet_says_what_the_list_of_part_60_asks_for(events):
    guide, pdf = usual(events())
    sheet = " ".join(sheet_of(texts(pdf), guide.tests[0].number).split())
    for words in (
        "Paragraph 1.f.1 engine acceleration; 14 CFR Part 60 App. A Table A2A",
        "Objective Show that the simulated engine accelerates as the aeroplane's does.",
        "Initial conditions flight Mach number 0.300",
        "Manual: from the initial conditions move the lever",
        "Automatic: the recorded inputs drive the model",
        "driven: TRA, Mach; constrained: none",
        "Ti ±10 % or 0.25 s; Tt ±10 % of the flight's",
        "Ti and Tt: unverified; check your edition",
        "flight.csv:left, engine left, t+0:16.90 to t+0:",
        "sha256 hash-of-flight.csv:left",
        f"Model, revision sha256 {SHA}",
        "Rationale",
        "Engineer: initials date",
        f"Simulation: product of calibration sha256 {SHA[:16]}",
    ):
        assert words in sheet


def test_the_index_leads_to_the_pages(events):
    guide, pdf = usual(events())
    pages = texts(pdf)
    (index,) = [text for text in pages if "Index of tests and results" in text]
    for test in guide.tests:
        (page,) = re.findall(rf"^{re.escape(test.number)} .* PASS (\d+)", index, re.MULTILINE)
        assert f"Test {test.number}\n" in pages[int(page) - 1]
    for number, text in enumerate(pages, start=1):
        assert f"Page {number} of {len(pages)}" in text


def test_the_critical_channel_decides_by_part60_and_every_channel_by_the_paper(events):
    slow = {"tau_s": (1.5, 1.6)}  # N2 alone is wrong
    by_n1, pdf = usual(events(**slow))
    assert by_n1.ok
    assert "N2 outside: explain by related variables." in texts(pdf)[-1]
    by_all = guide_of(events("paper", **slow), "run")
    assert not by_all.ok
    assert by_all.counts["FAIL"] == len(by_all.tests)
    document = by_n1.document()
    assert (document["tests"][0]["deciding"], document["counts"]["PASS"]) == (
        ["N1_pct"],
        len(by_n1.tests),
    )


def test_the_other_reading_of_an_open_tolerance_is_printed_where_it_differs(events, tmp_path):
    file = tmp_path / "tests.toml"
    text = start_file(events(), file).replace('critical = ""', 'critical = "N2_pct"')
    file.write_text(text, "utf-8")
    # 90 % of N2 after 1.84 s in flight, 2.07 s in the model: the floor is more than 10 %.
    found = events("cs-fstd", tau_s=(1.5, 0.9))
    guide = guide_of(found, "run", read_tests(file), file)
    assert [(test.result, test.otherwise) for test in guide.tests] == [(False, True)] * 2
    said = "By the other reading of the tolerance of Tt: PASS."
    assert all(said in text for text in texts(guide_pdf(guide))[-2:])


@pytest.mark.parametrize(("wow", "push", "pull"), [(None, None, None), (0.0, None, False),
                                                   (1.0, False, True)])  # fmt: skip
def test_an_event_flown_elsewhere_than_its_paragraph_asks_is_no_test(events, wow, push, pull):
    found = events(wow=wow)
    guide = guide_of(found, "run")
    met = {test.one.event.label: test.condition_met for test in guide.tests}
    assert met == {label: ok for label, ok in enumerate((push, pull)) if ok is not False}
    reasons = {why for one, why in guide.left_out if one.one.event.speed == "fast"}
    assert len(reasons) == (push is False) + (pull is False)
    assert all("requires" in why for why in reasons)


def test_the_same_guide_has_the_same_bytes_in_any_process(events):
    guide, pdf = usual(events())
    assert guide_pdf(guide) == pdf
    assert b"CreationDate" not in pdf
    assert to_json(guide.document()) == to_json(guide_of(events(), "run").document())


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_seed_of_hashes(tmp_path):
    script = (
        "import hashlib\nfrom eval.report.pdf import Page, to_pdf\n"
        "page = Page(('left', 'right'), 'foot')\npage.paragraph('Ti ±10 % of 3.2 °C, naïve')\n"
        "print(hashlib.sha256(to_pdf([page], 1, 'title')).hexdigest())"
    )
    found = {
        subprocess.run(
            [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT), "MPLCONFIGDIR": str(tmp_path)},
        ).stdout
        for seed in ("1", "2")
    }  # fmt: skip
    assert len(found) == 1


def test_pages_are_drawn_in_vectors_with_embedded_letters(events):
    reader = PdfReader(io.BytesIO(usual(events())[1]))
    kinds = set()
    for page in reader.pages:
        assert list(page.images) == []
        width, height = (float(part) * 25.4 / 72.0 for part in page.mediabox[2:])
        assert (width, height) == (pytest.approx(210.0), pytest.approx(297.0))
        for font in page["/Resources"]["/Font"].values():
            (below,) = font.get_object()["/DescendantFonts"]
            assert "/FontFile2" in below.get_object()["/FontDescriptor"]
            kinds.add(below.get_object()["/Subtype"])
    assert kinds == {"/CIDFontType2"}


@pytest.mark.slow
def test_120_events_are_no_more_than_10_megabytes(events):
    few, more = (usual(events(duration_s=length_s)) for length_s in (50.0, 130.0))
    added = len(more[0].tests) - len(few[0].tests)
    assert added == 4
    assert len(few[1]) + 118 * (len(more[1]) - len(few[1])) / added <= 10e6


@pytest.mark.parametrize("name", ["tests.toml", "tests.csv"])
def test_the_start_of_a_file_of_tests_gives_the_same_guide(events, tmp_path, name):
    found = events()
    file = tmp_path / name
    file.write_text(start_file(found, file), "utf-8")
    plain, listed = guide_of(found, "run"), guide_of(found, "run", read_tests(file), file)
    names = [[test.number for test in guide.tests] for guide in (plain, listed)]
    assert names[0] == names[1]
    assert plain.left_out == listed.left_out


HEAD = 'schema = "narxcal.qtg_tests/1"\n'


def entry(at_s, **more):
    given = {"log": "flight.csv:left", "start_s": at_s, **more}
    return "[[test]]\n" + "".join(f"{name} = {json.dumps(value)}\n"
                                  for name, value in given.items())  # fmt: skip


@pytest.fixture
def listed(events, tmp_path):
    """Makes the guide of a file of tests."""
    file = tmp_path / "tests.toml"

    def made(text, master=None):
        file.write_text(HEAD + text, "utf-8")
        return guide_of(events(), "run", read_tests(file), file, master)

    return made


def test_tests_are_chosen_titled_and_annotated_in_a_file(events, listed):
    fast = [test.one.event.start_s for test in guide_of(events(), "run").tests]
    text = '[document]\ndevice = "FFS 7"\nplace = "Exeter"\ndate = "2026-11-26"\n' + entry(
        fast[0], number="A-1", title="Go-around 超 <b>$x$</b>", configuration="flaps 20",
        rationale="Probe changed after the flight.",
    )  # fmt: skip
    guide = listed(text)
    pages = texts(guide_pdf(guide))
    sheet = sheet_of(pages, "A-1")
    for words in ("A-1  Go-around U+8D85 <b>$x$</b>", "flaps 20", "Probe changed after the flight.",
                  "Exeter, 2026-11-26"):  # fmt: skip
        assert words in sheet
    assert "FFS 7" in pages[0]
    assert len(guide.left_out) == len(events().found) - 1
    assert {why for _, why in guide.left_out} >= {"not chosen"}


NEAREST = (
    "no event of the log 'flight.csv:left' begins at start_s = 3. The nearest has start_s = 19.900"
)
NUMBER = "Input should be a valid number, unable to parse string as a number, found 'noon'"
NONE = "no event is a test (2 events; not chosen). Choose events by use = true in a file of tests"
KNOWN = "Known keys: configuration, log, number, rationale, start_s, title, use"
LOG = "no event is of the log 'fligt.csv:left'. Did you mean 'flight.csv:left'?"
TWICE = "the event start_s = 19.9 of 'flight.csv:left' is listed twice. Keep one"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no [[test]] is listed. Write a first version by --write-tests"),
        (entry(3.0), NEAREST),
        (entry(19.9).replace("flight.csv:left", "fligt.csv:left"), LOG),
        (entry(19.9) * 2, TWICE),
        (
            entry(19.9, number="1") + entry(39.9, number="1"),
            "two tests have the number '1'. Change one",
        ),
        (entry(19.9, start_s="noon"), f"key 'test.0.start_s': {NUMBER}"),
        (entry(19.9, use=False), f"{NONE}, as --write-tests writes one"),
        (entry(19.9, colour="red"), f"unknown key 'test.0.colour'. {KNOWN}"),
    ],
)
def test_a_wrong_file_of_tests_is_refused(listed, tmp_path, text, message):
    with pytest.raises(ConfigError) as refused:
        listed(text)
    assert str(refused.value) == f"{tmp_path / 'tests.toml'}: {message}"


def test_tests_may_stand_in_a_csv(events, tmp_path):
    file = tmp_path / "tests.csv"
    file.write_text(
        '\ufefflog,start_s,use,rationale\nflight.csv:left,19.9,,"Probe, changed"\n', "utf-8"
    )
    (test,) = guide_of(events(), "run", read_tests(file), file).tests
    assert (test.entry.use, test.entry.rationale) == (True, "Probe, changed")
    file.write_text("log,start_s\nflight.csv:left,19.9,1\n", "utf-8")
    with pytest.raises(ConfigError, match=r"unknown key 'test\.0\.more cells than"):
        read_tests(file)


def test_a_critical_channel_that_is_not_judged_is_refused(listed):
    with pytest.raises(ConfigError) as refused:
        listed('critical = "EGT_C"\n' + entry(19.9))
    assert str(refused.value) == (
        "channel EGT_C: the critical channel is not judged by the run. "
        "Name one of N1_pct, N2_pct, or judge it by [evaluate.transients]"
    )


def test_a_rationale_that_fills_the_sheet_is_refused(listed):
    guide = listed(entry(19.9, number="7", rationale="word " * 2000))
    with pytest.raises(ConfigError) as refused:
        guide_pdf(guide)
    assert str(refused.value) == (
        "the sheet of test '7' has no room for its texts. "
        "Shorten its rationale or configuration, and refer to another document"
    )


@pytest.fixture
def master(events, tmp_path):
    file = tmp_path / "master.json"
    file.write_text(to_json(guide_of(events(), "run").document()), "utf-8")
    return file


def test_a_recurrent_run_of_the_same_model_lies_on_its_master(events, master):
    guide = guide_of(events(), "run", master=read_master(master))
    for test in guide.tests:
        time, values = test.master.curve("N1_pct")
        rows = test.view.rows(test.one.event)
        np.testing.assert_allclose(time, test.view.log.time_s[rows], atol=1e-9)
        np.testing.assert_allclose(values, test.view.curves(rows)[0].model, rtol=1e-5)
    pages = texts(guide_pdf(guide))
    assert "recurrent: over the master of the same model" in pages[0]
    changes = re.findall(r"^master (\S+) (\S+) (\S+) (\S+) PASS$", pages[-1], re.MULTILINE)
    assert len(changes) == 2
    assert all((first, second) == ("+0.000", "+0.000") for _, first, _, second in changes)


def test_tests_of_the_master_that_are_not_repeated_are_named(events, listed, master):
    guide = listed(entry(19.9), read_master(master))
    left = guide.not_repeated
    assert len(left) == len(usual(events())[0].tests) - 1
    (index,) = [text for text in texts(guide_pdf(guide)) if "Index of tests and results" in text]
    assert f"Tests of the master: {', '.join(left)}." in index
    assert listed(entry(19.9)).not_repeated == ()


def sealed(document, name, value):
    del document["sha256"]
    changed = {**document, name: value}
    return to_json({**changed, "sha256": seal(changed)})


def test_a_master_by_other_rules_is_refused(events, master):
    message = (
        f"{master}: its times are by the rules 'part60', these by 'cs-fstd'. Add --rules part60"
    )
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        guide_of(events("cs-fstd"), "run", master=read_master(master))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace('"PASS"', '"FAIL"', 1),
         "the file was altered or cut off: its sha256 differs"),
        (lambda text: text.replace("narxcal.qtg/1", "narxcal.evaluate/1"),
         "expected schema 'narxcal.qtg/1', found 'narxcal.evaluate/1'"),
        (lambda text: sealed(json.loads(text), "tests", [{"sha256": SHA}]),
         "a part is missing or of a wrong type ('log')"),
        (lambda text: text[:100], "expected JSON, found something else"),
    ],
)  # fmt: skip
def test_a_master_that_is_none_is_refused(master, change, message):
    master.write_text(change(master.read_text("utf-8")), "utf-8")
    message = f"{master}: {message}. Name a qtg.json that narxcal qtg wrote"
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        read_master(master)


def test_a_master_of_other_events_is_refused(events, make_log, master):
    found = events()
    part = found.found[0].view.log
    other = replace(part, source=replace(part.source, sha256=hashlib.sha256(b"").hexdigest()))
    moved = tuple(replace(one, view=replace(one.view, log=other)) for one in found.found)
    message = f"{master}: none of its tests is one of these events. {LOGS}"
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        guide_of(replace(found, found=moved), "run", master=read_master(master))


def test_text_is_wrapped_to_its_width_and_nothing_is_lost():
    text = "Two words, then " + "x" * 400 + " and ±0.25 s of the flight's time"
    lines = wrapped(text, 60.0, 7.5)
    assert all(width_mm(line, 7.5) <= 60.0 for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert wrapped("", 60.0, 7.5) == [""]
    assert width_mm("1.f.1", 7.5) < RIGHT
    assert printable("a\tb\x07超") == "a bU+0007U+8D85"
