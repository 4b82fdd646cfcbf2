"""What recorders and worksheets put above the rows, and how they write what they do not know."""

import codecs
import datetime as dt
import sys

import numpy as np
import pytest

from data_prep.config import LogsConfig
from data_prep.reading import read_logs
from data_prep.sources.csv_source import Pace
from data_prep.sources.log_file import LogFile
from data_prep.sources.text_file import READERS
from data_prep.sources.units import is_unit_text, named_unit
from narxcal.support.errors import NarxcalError

COLUMNS = {"time_s": {"column": "t"}, "N1_pct": {"column": "fan"}, "EGT_C": {"column": "itt"}}
ROWS = "".join(f"{k / 10},{80 + k},{500 + k}\n" for k in range(40))


def config(**changed):
    """COLUMNS, with more said of some of them; or time, speed and another one, by its name."""
    more = {name: {"column": each} for name, each in changed.items() if isinstance(each, str)}
    some = {name: COLUMNS[name] for name in ("time_s", "N1_pct")} | more if more else COLUMNS
    said = {**changed, **more}
    columns = {name: {**source, **said.get(name, {})} for name, source in some.items()}
    return LogsConfig.parse({"columns": columns})


def write(folder, text, encoding="utf-8"):
    path = folder / "log.csv"
    path.write_bytes(text.encode(encoding))
    return path


def changes(log):
    return [(one.channel, one.action, one.reason, one.samples) for one in log.audit.entries]


def error_of(path, wanted):
    with pytest.raises(NarxcalError) as caught:
        read_logs(path, wanted)
    return str(caught.value).replace(str(path), "FILE")


@pytest.mark.parametrize(
    ("above", "lines"),
    [
        ("", 0),
        ("Recorder 7\nflown 2026-03-01, by, all\n\n", 2),
        ("# a comment\n", 0),
        ("sep=,\n", 0),
    ],
)
@pytest.mark.parametrize("units", ["", "s,%,degC\n", "[sec],[PCT],(deg C)\n", ",,°C\n"])
def test_the_rows_below_any_head_are_found(tmp_path, above, lines, units):
    path = write(tmp_path, f"{above}t,fan,itt\n\n{units}{ROWS}")
    (log,) = read_logs(path, config())
    np.testing.assert_array_equal(log["EGT_C"], 500.0 + np.arange(40))
    told = [("*", "dropped", "line above the header", lines)] if lines else []
    told += [("*", "dropped", "row of units", 1)] if units else []
    assert changes(log) == told


KELVIN, FAHRENHEIT = (1.0, -273.15), (1 / 1.8, -32 / 1.8)
SAY = "Say what it is in [logs.columns]: unit of {0}, or scale and offset"
DENSITY = "Set density_kgpl of FF_kgph in [logs.columns]: kg of fuel in a litre, about 0.8"


@pytest.mark.parametrize(
    ("head", "changed", "line", "reason"),
    [
        # What the file says counts where the configuration leaves it open, and only there.
        ("t,fan,itt\ns,-,K", {}, KELVIN, "K, as its row of units says"),
        ("t,fan,itt\ns,rpm,K", {"EGT_C": {"unit": "degC"}, "N1_pct": {"scale": 1.0, "unit": "%"}},
         (1.0, 0.0), "unit of the configuration, where the row of units says K"),
        ("t,fan,itt [degF]", {"EGT_C": {"column": "itt [degF]"}}, FAHRENHEIT,
         "degF, as its header says"),
        ("t,fan,itt [degF]", {"EGT_C": {"column": "itt [degF]", "unit": "degC"}}, (1.0, 0.0),
         "unit of the configuration, where the header says degF"),
        ("t,fan,itt (deg. F)", {"EGT_C": {"column": "itt (deg. F)"}}, FAHRENHEIT,
         "degF, as its header says"),
        # A row of units speaks for all columns.
        ("t [ms],fan,itt [degF]\ns,%,K",
         {"time_s": {"column": "t [ms]"}, "EGT_C": {"column": "itt [degF]"}}, KELVIN,
         "K, as its row of units says"),
        *((f"{above}t,fan,itt", {}, FAHRENHEIT, "degF, as its row of units says")
          for above in ("#s,%,deg F\n", ",%,degF\n", "# a title\n#s, %, degF\n",
                        "sec,pct,Deg. F\nRecorder 7,by all,1\n")),
    ],
)  # fmt: skip
def test_a_unit_of_the_file_counts_unless_the_configuration_says_one(
    tmp_path, head, changed, line, reason
):
    (log,) = read_logs(write(tmp_path, f"{head}\n{ROWS}"), config(**changed))
    assert log.dt_s == pytest.approx(0.1)
    np.testing.assert_allclose(log["EGT_C"], line[0] * (500.0 + np.arange(40)) + line[1])
    np.testing.assert_array_equal(log["N1_pct"], 80.0 + np.arange(40))
    said = [one for one in changes(log) if one[0] != "*"]
    assert said == [("EGT_C", "repaired", reason, 40)]


@pytest.mark.parametrize(
    ("name", "column", "factor"),
    [
        ("FF_kgph", "fuel (lbs/hr)", 0.45359237),
        ("ALT_ft", "altitude (meters)", 1.0 / 0.3048),
        ("TAS_kt", "TAS (mph)", 1.609344 / 1.852),
    ],
)
def test_a_spelled_out_unit_in_brackets_converts(tmp_path, name, column, factor):
    (log,) = read_logs(write(tmp_path, f"t,fan,{column}\n{ROWS}"), config(**{name: column}))
    np.testing.assert_allclose(log[name], factor * (500.0 + np.arange(40)))


@pytest.mark.parametrize(
    ("head", "name", "said", "hint"),
    [
        ("t,fan,itt\ns,rpm,degC", "N1_pct", "row of units says 'rpm', which does not fit %", SAY),
        ("t,fan,itt\ns,%,deg", "EGT_C", "row of units says 'deg', which does not fit degC", SAY),
        ("t,fan,itt\ns,shaft,degC", "N1_pct", "row of units says 'shaft', which is not known", SAY),
        ("#s,%,ohm\nt,fan,itt", "EGT_C", "row of units says 'ohm', which is not known", SAY),
        (",[%],[ohm]\nt,fan,itt", "EGT_C", "row of units says '[ohm]', which is not known", SAY),
        *((f"t,fan,x ({text})", name, f"header says '{text}', which {why}", hint)
          for name, text, why, hint in (
              ("FF_kgph", "gal/hr", "is a flow of volume", DENSITY),
              ("FF_kgph", "l/min", "is a flow of volume", DENSITY),
              ("N1_pct", "RPM", "does not fit %", SAY),
              ("FN_kN", "lbs", "is not known", SAY),
              ("ALT_ft", "furlong", "is not known", SAY),
              ("ALT_ft", "knots", "does not fit ft", SAY),
          )),
    ],
)  # fmt: skip
def test_a_unit_that_cannot_be_is_not_guessed(tmp_path, head, name, said, hint):
    own = {} if "itt" in head else {name: head.rpartition(",")[2]}
    assert error_of(write(tmp_path, f"{head}\n{ROWS}"), config(**own)) == (
        f"FILE, channel {name}: the {said}. {hint.format(name)}"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ROWS, ("FILE: the file has no header: its first line holds numbers. "
               "Write the names of the columns above it")),
        ("t,fan,itt\n0,80,500\n0.1;81;501\n",
         ("FILE, row 2: the header is separated by ',', this row by ';'. "
         "Use one delimiter in all rows")),
        ('t,fan,itt\n0,80,500\n"1,000.5",81,501\n',
         ("FILE, channel t, row 2: expected a number, found '1,000.5'. Write numbers without a "
         "separator of thousands")),
        ("t | fan | itt |\n0 | 80 | 1,009.940 | \n1 | 81 | 1,013.140 | \n",
         ("FILE, channel itt, row 1: expected a number, found '1,009.940 '. Write numbers without "
         "a separator of thousands")),
        ("t,fan,itt\n0,80,500\n03/01/2026 12:00:00,81,501\n",
         ("FILE, channel t, row 2: expected a number, found '03/01/2026 12:00:00'. Stamps are "
         "seconds, clock times HH:MM:SS or dates like 2026-03-01T12:00:00")),
        (f"t,fan,itt\n{ROWS.replace('1.0,90,510', '1.0,90,ON')}",
         ("FILE, channel itt, row 11: expected a number, found 'ON'. Correct it or leave it blank; "
         "row 1 is the first data row below the header")),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_told_with_what_to_do(tmp_path, text, message):
    assert error_of(write(tmp_path, text), config()) == message


@pytest.mark.parametrize(
    ("head", "column", "engines", "said"),
    [
        ("t,l_itt,r_itt\ns,degC,K", "{engine}itt", ("l_", "r_"),
         "row of units says 'degC' and 'K'"),
        ("t,itt 1 [degF],itt 2 [K]", "itt {engine}", ("1 [degF]", "2 [K]"),
         "header says 'degF' and 'K'"),
    ],
)  # fmt: skip
def test_engines_whose_units_differ_are_refused(tmp_path, head, column, engines, said):
    columns = {"time_s": {"column": "t"}, "EGT_C": {"column": column}}
    both = {"columns": columns, "engines": dict(zip(("left", "right"), engines, strict=True))}
    assert error_of(write(tmp_path, f"{head}\n{ROWS}"), LogsConfig.parse(both)) == (
        f"FILE: the {said} of the engines' columns. "
        f"Set the unit of column '{column}' in [logs.columns]"
    )


@pytest.mark.parametrize("cell", ["[kg/h]", "( KG/H )", "kg/hr", " kgph"])
def test_a_unit_is_known_in_brackets_and_any_case(cell):
    assert named_unit(cell) == "kg/h"
    assert is_unit_text(cell)
    assert not is_unit_text("fan speed")


@pytest.mark.parametrize(
    ("below", "units", "others"),
    [
        ("(sec),(),()\nNUMBER,%N(3),DEGC(4)\n", 1, 1),
        ("time,fan speed,gas\n", 0, 1),
        ("NUMBER,NUMBER,NUMBER\n17,203,204\nsec,%,degC\n", 1, 2),
        ("float,float,float\nTIME,N1,EGT\nsec,%,degC\nA,B,C\n", 1, 3),
        ("(sec),(%),(furlong)\n", 1, 0),
    ],
)
def test_rows_of_units_types_and_codes_are_found_and_counted(tmp_path, below, units, others):
    path = write(tmp_path, f"t,fan,itt\n{below}{ROWS}")
    (log,) = read_logs(path, config(EGT_C={"unit": "degC"}))
    np.testing.assert_array_equal(log["EGT_C"], 500.0 + np.arange(40))
    found = {reason: samples for channel, _, reason, samples in changes(log) if channel == "*"}
    expected = {"row of units": units, "row of types or codes below the header": others}
    assert found == {reason: samples for reason, samples in expected.items() if samples}


@pytest.mark.parametrize(
    "text", ["N/A", "n/a", "-", "---", "NULL", "#DIV/0!", "*", "NCD", "Fail ", "INVALID", "#N/A"]
)
def test_words_for_no_value_are_none_and_counted(tmp_path, text):
    rows = ROWS.replace("1.0,90,510", f"1.0,90,{text}").replace("3.0,110,530", f"3.0,{text},530")
    (log,) = read_logs(write(tmp_path, f"t,fan,itt\n{rows}"), config())
    reason = f"no value: {text.strip()}"
    assert changes(log) == [
        (channel, *change)
        for channel in ("N1_pct", "EGT_C")
        for change in (("dropped", reason, 1), ("filled", "blank", 1))
    ]


@pytest.mark.parametrize("text", ["NaN", ""])
def test_a_missing_number_is_a_blank(tmp_path, text):
    rows = ROWS.replace("1.0,90,510", f"1.0,90,{text}")
    (log,) = read_logs(write(tmp_path, f"t,fan,itt\n{rows}"), config())
    assert changes(log) == [("EGT_C", "filled", "blank", 1)]


def test_a_word_of_the_recorder_s_own_is_named_in_the_configuration(tmp_path):
    path = write(tmp_path, f"t,fan,itt\n{ROWS.replace('1.0,90,510', '1.0,90,no sync')}")
    assert "found 'no sync'" in error_of(path, config())
    own = LogsConfig.parse({"columns": COLUMNS, "no_value": ["No Sync"]})
    assert ("EGT_C", "dropped", "no value: no sync", 1) in changes(read_logs(path, own)[0])


@pytest.mark.parametrize(
    ("on", "off"), [("ON", "OFF"), ("True", "False"), ("GROUND", "AIR"), ("yes", "no"), ("1", "0")]
)
def test_words_of_a_switch_are_one_and_zero(tmp_path, on, off):
    rows = "".join(f"{k / 10},{80 + k},{on if 10 <= k < 30 else off}\n" for k in range(40))
    columns = {"time_s": {"column": "t"}, "N1_pct": {"column": "fan"}, "WOW": {"column": "gear"}}
    (log,) = read_logs(
        write(tmp_path, f"t,fan,gear\n{rows}"), LogsConfig.parse({"columns": columns})
    )
    np.testing.assert_array_equal(log["WOW"], (np.arange(40) // 10 % 3 > 0).astype(float))


def test_a_header_that_occurs_again_and_text_at_the_end_are_no_rows(tmp_path):
    head = "t,fan,itt\ns,%,degC\n"
    rows = ROWS.replace("1.0,90", f"{head}1.0,90") + "Average,99,520\nMaximum,119,539\n"
    (log,) = read_logs(write(tmp_path, f"{head}{rows}"), config())
    np.testing.assert_array_equal(log["EGT_C"], 500.0 + np.arange(40))
    assert ("*", "dropped", "header again", 2) in changes(log)
    assert ("*", "dropped", "row below the data: Average", 2) in changes(log)


def test_text_between_rows_is_no_footer_however_the_file_is_read(tmp_path):
    rows = ROWS.replace("1.0,90", "Average,90")
    path = write(tmp_path, f"t,fan,itt\n{rows}")
    with pytest.raises(NarxcalError, match="row 11: expected a number, found 'Average'"):
        read_logs(path, config())
    with pytest.raises(NarxcalError, match="row 11: expected a number, found 'Average'"):
        list(LogFile(path, config()).blocks([""], Pace(lines=11)))


@pytest.mark.parametrize("name", ["Gas [degF]", "Gas \n [degF]"])
def test_quoted_cells_may_hold_ends_of_lines(tmp_path, name):
    rows = "".join(f'{k / 10},{80 + k},{500 + k},"two\nlines, ""so"""\n' for k in range(40))
    path = write(tmp_path, f't,fan,"Gas\r\n [degF]","remark\n"\n{rows}')
    (log,) = read_logs(path, config(EGT_C={"column": name}))
    np.testing.assert_allclose(log["EGT_C"], (468.0 + np.arange(40)) / 1.8)


def test_lines_of_comments_are_skipped_wherever_they_stand(tmp_path):
    rows = ROWS.replace("1.0,90", "# paused, 1\n  # and resumed\n1.0,90")
    (log,) = read_logs(write(tmp_path, f"t,fan,itt\n{rows}# the end"), config())
    np.testing.assert_array_equal(log["EGT_C"], 500.0 + np.arange(40))


@pytest.mark.parametrize("mark", ["", "\ufeff"])  # before that of an encoding: a second one
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "cp1252", "utf-16"])
def test_a_degree_sign_in_the_header_is_one_in_any_encoding(tmp_path, encoding, mark):
    mark = mark if encoding.startswith("utf") else ""
    path = write(tmp_path, f"{mark}t,fan,itt °C\n{ROWS}", encoding)
    named = config(EGT_C={"column": "itt °C"})
    (log,) = read_logs(path, named)
    np.testing.assert_array_equal(log["EGT_C"], 500.0 + np.arange(40))


def test_a_sign_that_ends_beyond_the_first_bytes_is_utf_8(tmp_path):
    path = tmp_path / "log.csv"
    head = b"t,fan,itt\n# " + b"x" * (65_536 - 13)
    path.write_bytes(head + "°".encode() + b"\n" + ROWS.encode())
    assert path.read_bytes()[65_535:65_537] == "°".encode()
    assert read_logs(path, config())[0]["EGT_C"][0] == 500.0


def test_thousands_are_not_taken_for_decimals(tmp_path):
    rows = ROWS.replace(".", "").replace("509", '"34,984"')
    path = write(tmp_path, f"t,fan,itt\n{rows}")
    assert error_of(path, config()) == (
        "FILE: the comma in '34,984' may be a decimal mark or one of thousands. "
        'Set [logs] decimal = "," if it is the former, else write numbers without it'
    )
    comma = LogsConfig.parse({"columns": COLUMNS, "decimal": ","})
    assert read_logs(path, comma)[0]["EGT_C"][9] == 34.984


def test_a_workbook_is_read_as_its_csv_twin(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    book.active.append(("Aircraft", "N123"))
    book.active = book.create_sheet("samples")
    twin = []
    begin = dt.datetime(2026, 3, 1, 11, 59, 55)  # noqa: DTZ001 - a cell has no zone
    for cells in (("t", "fan", "itt"), ("", "%", "deg F")):
        book.active.append(cells)
        twin.append(",".join(cells))
    for k in range(40):
        cells = (begin + dt.timedelta(seconds=k), 80 + k / 7, None if k == 5 else 500 + k)
        book.active.append(cells)
        twin.append(f"{cells[0].isoformat()},{cells[1]!r},{'' if k == 5 else cells[2]}")
    book.save(tmp_path / "log.xlsx")
    (log,) = read_logs(tmp_path / "log.xlsx", config())
    (same,) = read_logs(write(tmp_path, "\n".join(twin) + "\n"), config())
    np.testing.assert_array_equal(log.time_s, same.time_s)
    for name in ("N1_pct", "EGT_C"):
        np.testing.assert_array_equal(log[name], same[name])
    assert changes(log) == changes(same)


def test_an_archive_that_is_no_workbook_is_refused(tmp_path):
    pytest.importorskip("python_calamine")
    path = tmp_path / "log.csv"
    path.write_bytes(b"PK\x03\x04" + bytes(range(256)))
    assert error_of(path, config()) == (
        "FILE: the file is an archive and no workbook that can be read. Save the sheet as CSV"
    )


def test_a_workbook_names_the_extra_that_reads_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "python_calamine", None)
    path = tmp_path / "log.csv"
    path.write_bytes(b"PK\x03\x04" + bytes(range(256)))
    assert error_of(path, config()) == (
        "FILE: workbooks of Excel need python-calamine. Install it with: "
        "pip install 'narxcal[excel]', or save the sheet as CSV"
    )


@pytest.mark.parametrize(
    "content",
    [
        codecs.BOM_UTF8 + bytes(range(1, 9)) + bytes(range(128, 256)),
        b"ULog\x01\x12\x35 a, b\n" + b"\x89HDF\x0d\x0a\x1a\x0a" + bytes(range(256)) * 20,
    ],
)
def test_a_file_of_no_format_lists_the_readers_and_their_extras(tmp_path, content):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    assert error_of(path, config()) == f"FILE: the file is no text. Formats are {READERS}"


def test_minutes_and_seconds_are_a_clock_time_too(tmp_path):
    rows = "".join(f"{k // 600:02d}:{k / 10 % 60:04.1f},{80 + k},500\n" for k in range(580, 640))
    (log,) = read_logs(write(tmp_path, f"t,fan,itt\n{rows}"), config())
    np.testing.assert_allclose(log.time_s, 58.0 + np.arange(60) / 10)


def minutes_of(*tenths):
    return [f"{each // 600 % 60:02d}:{each / 10 % 60:04.1f}" for each in tenths]


def test_a_worksheet_s_clock_without_hours_goes_on_each_hour(tmp_path):
    stamps = minutes_of(*range(35_900, 72_100))
    stamps[99], stamps[100] = stamps[100], stamps[99]  # a row that comes late, just there
    rows = "".join(f"{stamp},{80 + k % 7},500\n" for k, stamp in enumerate(stamps))
    path = write(tmp_path, f"t,fan,itt\n{rows}")
    (log,) = read_logs(path, config())
    np.testing.assert_allclose(log.time_s, 3590.0 + np.arange(36_200) / 10, atol=1e-6)
    moved = {entry.reason: entry.samples for entry in log.audit.entries}
    assert moved["clock of minutes starts anew each hour"] == 36_100
    file = LogFile(path, config())
    stream = file.stream(0.1, 0.0)
    blocks = file.blocks([""], Pace(lines=2000))
    pieces = [piece for block in blocks for piece in stream.push(block[""])]
    pieces += stream.push({}, last=True)
    live = np.concatenate([piece.time_s for piece in pieces])
    np.testing.assert_allclose(live, log.time_s, atol=1e-6)


SECOND = (
    "It holds more than one recording: split the file there, or name the column that tells them "
    "apart in [logs] instances"
)
WORKSHEET = (
    "A worksheet that shows MM:SS.0 leaves the hours out: write HH:MM:SS.0; or, if it holds more "
    "than one recording, split the file there"
)


@pytest.mark.parametrize(
    ("stamps", "row", "ends_s", "hint"),
    [
        (minutes_of(*range(35_980, 36_000), *range(21, 61)), 21, "3599.9 s to 2.1", WORKSHEET),
        (minutes_of(*range(35_980, 36_000), *range(600, 640)), 21, "3599.9 s to 60", SECOND),
        ([f"{3595 + k / 10}" for k in range(50)] + ["0.0", "0.1"], 51, "3599.9 s to 0", WORKSHEET),
        (
            [f"23:58:{38 + k / 10:04.1f}" for k in range(20)]
            + [f"00:00:0{k / 10}" for k in range(40)],
            21,
            "86319.9 s to 0",
            SECOND,
        ),
    ],
)
def test_time_that_goes_back_is_a_second_recording(tmp_path, stamps, row, ends_s, hint):
    rows = "".join(f"{stamp},80,500\n" for stamp in stamps)
    assert error_of(write(tmp_path, f"t,fan,itt\n{rows}"), config()) == (
        f"FILE, channel time_s, row {row}: time goes back from {ends_s} s. {hint}"
    )


@pytest.mark.parametrize("end", ["[R]", "(1)", "[raw]", "(m)", "(probe 2)", "[-]", "{L}", "[]"])
def test_brackets_that_are_no_unit_of_the_channel_are_part_of_the_name(tmp_path, end):
    path = write(tmp_path, f"t,fan {end},itt {end}\n{ROWS}")
    named = {"time_s": "t", "N1_pct": f"fan {end}", "EGT_C": f"itt {end}"}
    each = {name: {"column": column} for name, column in named.items()}
    (log,) = read_logs(path, LogsConfig.parse({"columns": each}))
    np.testing.assert_array_equal(log["EGT_C"], 500.0 + np.arange(40))
    np.testing.assert_array_equal(log["N1_pct"], 80.0 + np.arange(40))
    assert changes(log) == []


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("Lbs./Hr", "lb/h"), ("pounds per hour", "lb/h"), ("PPH", "lb/h"), ("deg. F", "degF"),
        ("Degrees Celsius", "degC"), ("meters", "m"), ("ft.", "ft"), ("FEET", "ft"),
        ("msec", "ms"), ("µs", "us"), ("minutes", "min"), ("Hours", "h"), ("mph", "mph"),
        ("knots", "kt"), ("Kg/sec", "kg/s"), ("metres per second", "m/s"), ("m.p.h.", "mph"),
    ],
)  # fmt: skip
def test_units_are_understood_as_they_are_spelled_out(text, unit):
    assert named_unit(f"[{text}]") == unit


@pytest.mark.parametrize("text", ["A", "L", "R", "2", "left", "raw", "C", "utc"])
def test_other_words_in_brackets_are_no_unit(tmp_path, text):
    column = f"N2 ({text})"
    path = write(tmp_path, f"t,fan,{column}\n{ROWS}")
    columns = {"time_s": {"column": "t"}, "N2_pct": {"column": column}}
    (log,) = read_logs(path, LogsConfig.parse({"columns": columns}))
    assert len(log) == 40


@pytest.mark.parametrize(
    ("text", "litres"), [("gal/hr", 3.785411784), ("l/min", 60.0), ("Liters per Hour", 1.0)]
)
@pytest.mark.parametrize("own", [False, True])
def test_fuel_by_volume_becomes_a_mass_flow_by_its_density(tmp_path, text, litres, own):
    column = "fuel" if own else f"fuel ({text})"
    path = write(tmp_path, f"t,fan,{column}\n{ROWS}")
    fuel = {"column": column, "density_kgpl": 0.8} | ({"unit": text} if own else {})
    columns = {"time_s": {"column": "t"}, "FF_kgph": fuel}
    (log,) = read_logs(path, LogsConfig.parse({"columns": columns}))
    np.testing.assert_allclose(log["FF_kgph"], 0.8 * litres * (500.0 + np.arange(40)))


@pytest.mark.parametrize("labels", [("0", "1"), ("LH", "RH"), ("7", "left")])
@pytest.mark.parametrize("interleaved", [True, False])
def test_instances_in_a_file_are_told_apart_by_a_column(tmp_path, labels, interleaved):
    rows = [(k / 10, label, 80 + k + 7 * n) for n, label in enumerate(labels) for k in range(40)]
    rows = sorted(rows, key=lambda row: row[0]) if interleaved else rows
    text = "".join(f"{t},{label},{fan}\n" for t, label, fan in rows)
    path = write(tmp_path, f"t,I,fan\n{text}")
    columns = {"time_s": {"column": "t"}, "N1_pct": {"column": "fan"}}
    logs = read_logs(path, LogsConfig.parse({"columns": columns, "instances": ["I"]}))
    assert {log.source.engine for log in logs} == set(labels)
    for log in logs:
        expected = 80.0 + np.arange(40) + 7.0 * labels.index(log.source.engine)
        np.testing.assert_array_equal(log["N1_pct"], expected)
        assert changes(log) == []


def test_units_and_cycles_are_recordings_of_their_own(tmp_path):
    rows = "".join(
        f"{unit},{cycle},{k / 10},{unit * 10 + cycle + k}\n"
        for unit in (1, 2) for cycle in (1, 2) for k in range(20)
    )  # fmt: skip
    path = write(tmp_path, f"unit,cycle,t,fan\n{rows}")
    columns = {"time_s": {"column": "t"}, "N1_pct": {"column": "fan"}}
    apart = LogsConfig.parse({"columns": columns, "instances": ["unit", "cycle"]})
    logs = read_logs(path, apart)
    assert [log.name for log in logs] == [f"log.csv:{key}" for key in ("1-1", "1-2", "2-1", "2-2")]
    np.testing.assert_array_equal(logs[2]["N1_pct"], 21.0 + np.arange(20))
    missing = LogsConfig.parse({"columns": columns, "instances": ["units"]})
    assert error_of(path, missing) == (
        "FILE: column 'units' of [logs] instances is missing. Did you mean 'unit'?"
    )
    with pytest.raises(NarxcalError, match="a file of several instances cannot be streamed"):
        next(LogFile(path, apart).blocks([""], Pace(live=True)))


def test_rows_of_no_instance_are_counted(tmp_path):
    columns = {"time_s": {"column": "t"}, "N1_pct": {"column": "fan"}}
    rows = "".join(f"{k / 10},{80 + k},{'' if k == 10 else 'A'}\n" for k in range(40))
    path = write(tmp_path, f"t,fan,I\n{rows}")
    (log,) = read_logs(path, LogsConfig.parse({"columns": columns, "instances": ["I"]}))
    assert ("*", "dropped", "row of no instance", 1) in changes(log)
