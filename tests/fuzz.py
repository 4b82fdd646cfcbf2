"""Fuzz the readers: `python -m tests.fuzz --cases 100000 --seed 1`, or `make fuzz N=100000`.

Each case takes a sound input, changes it, and hands it to the code that users hand it to. It must
give a result or one of the documented errors, without a warning, within `LIMIT_S` seconds of the
processor and `LIMIT_MB` of memory. A case depends on its seed and number alone; the input of one
that fails is kept in a folder.
"""

import argparse
import collections
import copy
import gzip
import hashlib
import json
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save as save_arrays

from data_prep.config import LogsConfig
from data_prep.log import Log
from data_prep.reading import read_logs
from eval.diagnosis.applied import read_effects, read_emulator
from eval.diagnosis.blind.files import read_cases
from eval.diagnosis.learned import learned_by
from eval.replay import ReplayModel, ReplayOptions, replay
from eval.run_logs import evaluation_logs
from narxcal import Narx
from narxcal.calibration.bundle import load_bundle
from narxcal.calibration.folder import seal
from narxcal.cli.app import main as main_of
from narxcal.cli.app import parse
from narxcal.flight_test.fly import load_scenario
from narxcal.steady.table import read_steady_table
from narxcal.support.errors import NarxcalError
from narxcal.support.files import sha256_of
from tests.golden.test_golden import FORMS, GOLDEN, resealed
from training import methods
from training.config import load_config
from training.dynamics.network import TrainingState
from training.methods import read_checkpoint, write_checkpoint

ROOT = Path(__file__).parents[1]
LIMIT_S, LIMIT_MB = 20, 3000
FLIGHT = (GOLDEN / "flight.csv").read_bytes()
TABLE = (GOLDEN / "maker.csv").read_bytes()
CONFIGS = tuple(sorted((ROOT / "configs").glob("*.toml"))) + tuple(GOLDEN.glob("*.toml"))

NUMBERS = (
    "nan", "inf", "-inf", "1e400", "-1e400", "1e308", "1e-320", "0", "-0", "1", "-1", "1e9", "0.5",
    "99999999999999999999", "0x1f", "1_000", "1,5", "1.234.567", "1e", "--1", "+", ".", "", " ",
)  # fmt: skip
WORDS = (
    *NUMBERS, "NaN", "N/A", "-", "true", "=1+1", "@SUM", '"', '""', '"a', "'", "\0", "\x1a",
    "\ufeff", "\u2212", "\u0661", "12:00:00", "2026-02-30T25:61:61", "24:00:00", "25.11.2026",
    "#", ";", ",", "\t", "|", "\r", "\n", "\r\n", "\\", "../x", "/dev/zero", "%", "{engine}",
    "[K]", "time_s", "N1_pct", "\u00e4\u6f22", "\U0001f6e9", "x" * 5000,
)  # fmt: skip
VALUES = (
    None, True, False, 0, 1, -1, 2, 0.5, -0.5, 1e-300, 1e300, 2**31, 2**63, -(2**63), 10**30, "",
    "0", "x", "N1_pct", "TRA_deg", "nan", "/etc/passwd", "../../x", "os:system", [], [[]], [1],
    ["N1_pct"], {}, {"": 0}, "\0", "\ud800",
)  # fmt: skip


# --- changes ---


def pick(rng, options):
    return options[int(rng.integers(len(options)))]


def bytes_changed(rng, data):
    """A few bytes flipped, cut, doubled, inserted or moved."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at, span = int(rng.integers(len(data) + 1)), int(2 ** rng.uniform(0, 10))
        kind = int(rng.integers(6))
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del data[at : at + span]
        elif kind == 2:
            data[at:at] = data[at : at + span]
        elif kind == 3:
            data[at:at] = pick(rng, WORDS).encode("utf-8", "surrogatepass")
        elif kind == 4:
            data[at : at + span] = rng.bytes(span)
        else:
            del data[at:]
    return bytes(data)


def cells_changed(rng, data):  # noqa: C901 -- one line per kind
    """Cells, columns or rows of a CSV text replaced, dropped, doubled, swapped, shifted."""
    rows = [line.split(",") for line in data.decode().splitlines()]
    for _ in range(int(rng.integers(1, 4))):
        kind, row = int(rng.integers(11)), int(rng.integers(len(rows)))
        column = int(rng.integers(len(rows[0]))) if rows[0] else 0
        if kind == 0 and rows[row]:
            rows[row][column % len(rows[row])] = pick(rng, WORDS)
        elif kind == 1:
            rows = [cells[:column] + cells[column + 1 :] for cells in rows]
        elif kind == 2:
            rows = [[*cells, *cells[column : column + 1]] for cells in rows]
        elif kind == 3:
            other = int(rng.integers(len(rows[0]) or 1))
            order = list(range(len(rows[0])))
            order[column : column + 1] = [other]
            rows[1:] = [[cells[k] for k in order if k < len(cells)] for cells in rows[1:]]
        elif kind == 4:
            del rows[row][column:]
        elif kind == 5:
            rows[row] = [pick(rng, WORDS), *rows[row]]
        elif kind == 6:
            word = pick(rng, WORDS)
            rows[1:] = [[*cells[:column], word, *cells[column + 1 :]] for cells in rows[1:]]
        elif kind == 7:
            scale = float(pick(rng, (0.0, -1.0, 1e-6, 100.0, 1e6, 1e200, 1.8, np.nan)))
            rows[1:] = [_scaled(cells, column, scale) for cells in rows[1:]]
        elif kind == 8:
            rows[row : row + 2] = rows[row : row + 2][::-1]
        elif kind == 9:
            rows = rows[: row + 1]
        else:
            rows[row:row] = [rows[row]] * int(rng.integers(1, 40))
        rows = rows or [[""]]
    mark = pick(rng, (*[","] * 7, ";", "\t", "|"))
    ending = pick(rng, (*["\n"] * 7, "\r\n", "\r"))
    return ending.join(mark.join(cells) for cells in rows).encode("utf-8", "surrogatepass")


def _scaled(cells, column, scale):
    try:
        value = float(cells[column]) * scale
    except (ValueError, IndexError, OverflowError):
        return cells
    return [*cells[:column], repr(value), *cells[column + 1 :]]


def encoded(rng, data):
    """Another encoding or compression, whole or cut off."""
    kind = int(rng.integers(3, 12) if rng.random() < 0.4 else 0)
    if kind < 6:
        return data, ".csv"
    if kind == 6:
        name = pick(rng, ("utf-16", "utf-32", "utf-8-sig", "utf-16-le"))
        return data.decode("utf-8", "replace").encode(name, "replace"), ".csv"
    if kind == 7:
        return data.decode("utf-8", "replace").encode("latin-1", "replace"), ".csv"
    if kind == 8:  # zeros or one line, which compress a thousandfold
        bomb = pick(rng, (b"\0", b"1,", b"a", b"\n")) * int(2 ** rng.uniform(10, 25))
        return gzip.compress(data[: int(rng.integers(400))] + bomb, 1), ".csv.gz"
    packed = gzip.compress(data, 1)
    if kind == 9:
        packed = packed[: int(rng.integers(len(packed)))]
    elif kind == 10:
        packed = bytes_changed(rng, packed)
    return packed, pick(rng, (".csv.gz", ".csv"))


def log_bytes(rng, data=FLIGHT):
    """Content of a log and the ending of its name."""
    kind = int(rng.integers(8))
    if kind == 0:
        data = bytes_changed(rng, data)
    elif kind == 1:
        data = pick(rng, WORDS).encode("utf-8", "surrogatepass") * int(2 ** rng.uniform(0, 16))
        data = data[:1_000_000]
    else:
        data = cells_changed(rng, data)
        if kind == 2 and rng.random() < 0.3:
            data = bytes_changed(rng, data)
    return encoded(rng, data)


def text_changed(rng, text):
    """A TOML text with words, lines, keys and tables exchanged."""
    for _ in range(int(rng.integers(1, 4))):
        kind, lines = int(rng.integers(7)), text.split("\n")
        line, other = (int(rng.integers(len(lines))) for _ in range(2))
        if kind < 3:
            tokens = [m.span() for m in re.finditer(r"[\w.+-]+|\"[^\"]*\"", text)]
            if tokens:
                start, stop = pick(rng, tokens)
                word = json.dumps(pick(rng, VALUES)) if kind == 0 else pick(rng, WORDS)
                word = text[slice(*pick(rng, tokens))] if kind == 2 else word
                text = text[:start] + word.replace("null", "[]") + text[stop:]
        elif kind == 3:
            text = "\n".join(lines[:line] + lines[line + 1 :])
        elif kind == 4:
            text = "\n".join([*lines[:line], lines[other], *lines[line:]])
        elif kind == 5:
            lines[line], lines[other] = lines[other], lines[line]
            text = "\n".join(lines)
        else:
            text += f"\n[{'.'.join(['a'] * int(2 ** rng.uniform(0, 12)))}]\n"
    return text


def value_changed(rng, value):
    """A JSON value with some of its parts exchanged, removed, renamed or nested deeply."""
    whole = {"": json.loads(json.dumps(value))}
    for _ in range(int(rng.integers(1, 4))):
        parent, key, place = whole, "", whole[""]
        while isinstance(place, (dict, list)) and place and rng.random() < 0.85:
            parent, key = (
                place,
                pick(rng, tuple(place) if isinstance(place, dict) else range(len(place))),
            )
            place = parent[key]
        kind = int(rng.integers(7))
        if kind == 0 and parent is not whole:
            del parent[key]
        elif kind == 1 and isinstance(parent, dict) and parent is not whole:
            parent[pick(rng, (*WORDS[:40], "x"))] = parent.pop(key)
        elif kind == 2:
            for _ in range(int(2 ** rng.uniform(0, 9))):
                place = [place]
            parent[key] = place
        elif kind == 3 and isinstance(place, (int, float)) and not isinstance(place, bool):
            parent[key] = pick(
                rng, (-place, place + 1, place * 1e6, 2**62, float(place), str(place))
            )
        elif kind == 4 and isinstance(parent, list):
            parent.insert(0, copy.deepcopy(pick(rng, VALUES)))
        else:
            parent[key] = copy.deepcopy(pick(rng, VALUES))
    return whole[""]


def arrays_changed(rng, data):
    """safetensors with other numbers, or another header."""
    size = struct.unpack("<Q", data[:8])[0]
    body = bytearray(data[8 + size :])
    header = data[8 : 8 + size]
    kind = int(rng.integers(4))
    if kind == 0:
        return bytes_changed(rng, data)
    if kind == 1:
        try:
            header = dumped(value_changed(rng, json.loads(header))).encode()
        except (TypeError, KeyError, AttributeError):
            header = b"{}"
    for _ in range(int(rng.integers(1, 4)) if kind > 1 else 0):
        at = 8 * int(rng.integers(max(1, len(body) // 8)))
        number = float(pick(rng, (np.nan, np.inf, 1e300, -1e300, 0.0, -1.0, 1e9, 1e-300)))
        body[at : at + 8] = struct.pack("<d", number)
    return struct.pack("<Q", len(header)) + header + bytes(body)


@contextmanager
def deeply():
    """What is nested may be written here, however deeply."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(100 * limit)
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


def dumped(value):
    with deeply():
        return json.dumps(value, indent=1)


def sealed(value):
    with deeply():
        return seal(value)


# --- what is handed to whom; each gets (rng, folder, sound) and returns a word about the result ---


def case_log(rng, folder, _sound):
    data, ending = log_bytes(rng)
    file = folder / f"log{ending}"
    file.write_bytes(data)
    changes = {}
    if rng.random() < 0.3:
        changes["raster_hz"] = float(pick(rng, (0.01, 0.5, 4.0, 32.0, 1000.0)))
    if rng.random() < 0.2:
        changes["delimiter"] = pick(rng, (",", ";", "\t", " "))
    if rng.random() < 0.2:
        changes["decimal"] = pick(rng, (".", ","))
    if rng.random() < 0.2:
        changes["columns"] = {
            name: {"column": name, "unit": unit, "optional": bool(rng.random() < 0.5)}
            for name, unit in (
                ("time_s", "s"),
                ("TRA_deg", "deg"),
                ("EGT_C", "degF"),
                ("N1_pct", "%"),
            )
        }
    logs = read_logs([file], LogsConfig.parse(changes))
    assert all(isinstance(log, Log) and len(log) > 0 for log in logs)
    return f"{min(len(logs), 3)} logs"


def case_prepared(rng, folder, sound):
    data, ending = log_bytes(rng)
    file = folder / f"log{ending}"
    file.write_bytes(data)
    bundle = sound.bundles[pick(rng, FORMS)]
    logs = evaluation_logs(bundle, [file])
    calibration = bundle.calibration
    for log in logs[:2]:
        found = calibration.simulate(log.matrix(calibration.input_names)[:200])
        assert np.isfinite(found).all(), "the free run is not finite"
    return "simulated"


def case_replay(rng, folder, sound):
    data, ending = log_bytes(rng)
    file, out = folder / f"log{ending}", folder / "out.csv"
    file.write_bytes(data)
    replay(sound.models[pick(rng, FORMS)], file, out, ReplayOptions())
    rows = out.read_text(encoding="utf-8").splitlines()
    assert len({row.count(",") for row in rows}) == 1, "rows of different length"
    assert "inf" not in "".join(rows[1:]), "an output is infinite"
    return "replayed"


def case_table(rng, folder, _sound):
    data, ending = log_bytes(rng, TABLE)
    file = folder / f"table{ending}"
    file.write_bytes(data)
    table = read_steady_table(file, None, None)
    found = table.outputs(table.points[:3])
    assert found.shape[1] == len(table.output_names)
    return "read"


def case_config(rng, folder, _sound):
    source = pick(rng, CONFIGS)
    text, file = source.read_text(encoding="utf-8"), folder / "config.toml"
    data = text_changed(rng, text).encode("utf-8", "surrogatepass")
    file.write_bytes(bytes_changed(rng, data) if rng.random() < 0.2 else data)
    flown = "narxcal.fly/" in text
    config = load_scenario(str(file)) if flown else load_config(file)[0]
    if not flown:
        json.loads(config.model_dump_json())
        config.logs.resolve(folder)
    return "read"


def case_bundle_bytes(rng, folder, sound):
    run = _copied(sound.folders[pick(rng, FORMS)], folder / "run")
    file = run / pick(rng, ("bundle.json", "weights.safetensors"))
    file.write_bytes(bytes_changed(rng, file.read_bytes()))
    return _used(run)


def case_bundle_resealed(rng, folder, sound):
    """Whoever can write a hash can write any content: it loads and is bounded, or is refused."""
    run = _copied(sound.folders[pick(rng, FORMS)], folder / "run")
    document = json.loads((run / "bundle.json").read_text(encoding="utf-8"))
    if rng.random() < 0.5:
        data = arrays_changed(rng, (run / "weights.safetensors").read_bytes())
        (run / "weights.safetensors").write_bytes(data)
        document["weights"]["sha256"] = hashlib.sha256(data).hexdigest()
    else:
        part = pick(
            rng, ("calibration", "calibration", "weights", "channels", "fuser_noise", "config")
        )
        changed = value_changed(rng, document.get(part))
        document = (
            {**document, part: changed} if rng.random() < 0.9 else value_changed(rng, document)
        )
    if isinstance(document, dict):
        document.pop("sha256", None)
        with suppress(ValueError, TypeError):
            document = {**document, "sha256": sealed(document)}
    text = dumped(document) + "\n"
    (run / "bundle.json").write_text(text, encoding="utf-8", errors="surrogatepass")
    return _used(run)


def _used(run):
    bundle = load_bundle(run)
    calibration = bundle.calibration
    rows = np.zeros((40, len(calibration.input_names)))
    found = calibration.simulate(rows)
    assert found.shape == (40, len(calibration.output_names))
    return "loaded"


def case_results(rng, folder, sound):
    """Documents that commands read again: effects, cases, what was learned, an estimator."""
    kind = int(rng.integers(6))
    if kind == 0:
        return _changed_json(rng, folder, "gap.json", GAP, lambda: read_effects(folder))
    if kind == 1:
        cases = {"schema": "narxcal.blind/1", "logs": {"case_01": {"flight_1.csv": "00"}}}
        return _changed_json(rng, folder, "cases.json", cases, lambda: read_cases(folder))
    if kind == 2:
        (folder / "bundle.json").write_text("{}")
        told = value_changed(
            rng, {"flights": 1, "basis": [[1.0]], "noise": {"N1_pct": [[0.1, 2.0]]}}
        )
        told = {"schema": "narxcal.discrepancy/1", **(told if isinstance(told, dict) else {})}
        told |= {"bundle_sha256": sha256_of(folder / "bundle.json")}
        learned = {**told, "sha256": sealed(told)}
        return _changed_json(rng, folder, "discrepancy.json", learned, lambda: learned_by(folder))
    if kind == 3:
        arrays = {name: np.ones((2, 3)) for name in ("low", "high", "weights", "theta", "thermal")}
        data = save_arrays(arrays)
        data = arrays_changed(rng, data) if rng.random() < 0.5 else data
        (folder / "weights.safetensors").write_bytes(data)
        stored = {**EMULATOR, "sha256": hashlib.sha256(data).hexdigest()}
        return _changed_json(rng, folder, "emulator.json", stored, lambda: read_emulator(folder))
    if kind == 4:
        run = _copied(sound.folders["limits"], folder / "run")
        (run / "evaluate").mkdir()
        read = partial(_command, "info", str(run))
        return _changed_json(rng, run / "evaluate", "evaluate.json", sound.scores(run), read)
    run = _copied(sound.estimator, folder / "narx")
    document = json.loads((run / "narx.json").read_text(encoding="utf-8"))
    own = ("parameters", "network", "result")
    changed = value_changed(rng, {key: document[key] for key in own})
    document |= changed if isinstance(changed, dict) else {}
    document["sha256"] = sealed({key: document.get(key) for key in own})
    (run / "narx.json").write_text(dumped(document) + "\n", encoding="utf-8")
    Narx.load(run)
    return "loaded"


def _command(*words):
    """Run a command; a documented error is raised again, an internal one is none."""
    errors = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(errors):
        code = main_of(words)
    assert code != 3, errors.getvalue()


def _changed_json(rng, folder, name, document, read):
    text = dumped(value_changed(rng, document)).encode()
    (folder / name).write_bytes(bytes_changed(rng, text) if rng.random() < 0.3 else text)
    read()
    return "read"


def case_checkpoint(rng, folder, _sound):
    file = folder / "joint.safetensors"
    write_checkpoint(file, TrainingState(np.arange(5.0)), "key")
    if rng.random() < 0.5:
        file.write_bytes(arrays_changed(rng, file.read_bytes()))
    else:  # as its author could have written it
        with safe_open(file, framework="numpy") as stored:
            header = stored.metadata()
        state = dumped(value_changed(rng, json.loads(header["state"])))
        arrays = {pick(rng, ("theta", "theta", "best_theta", "first")): np.ones(3)}
        header |= {"state": state, "sha256": methods._digest(arrays, state)}
        file.write_bytes(save_arrays(arrays, header))
    read_checkpoint(file, "key")
    return "read"


SIGNALS = {
    "inputs": ["TRA_deg"], "outputs": ["N1_pct"], "dt_s": 0.25, "driver": 0,
    "low": [0.0], "high": [1.0], "lever": [0.0, 70.0], "active": ["TRA_deg"],
}  # fmt: skip
GAP = {
    "schema": "narxcal.gap/2",
    "quality": {"signals": SIGNALS, "flights": ["a", "b"], "held_out": []},
    "verdict": {"effects": ["sensor_lag:N1_pct"]},
    "effects": [
        {
            "id": "sensor_lag",
            "channel": "N1_pct",
            "parameters": {"tau_s": {"value": 1.5, "unit": "s"}},
            "windows": [{"log": "a", "log_start_s": 0.0, "start_s": 1.0, "end_s": 2.0}],
        }
    ],
}
EMULATOR = {
    "schema": "narxcal.emulator/4", "signals": SIGNALS, "conditions": ["ALT_ft"], "switches": [],
    "core": {"low_pct": 50.0, "span_pct": 40.0}, "governed": 0, "dt_s": 0.25,
}  # fmt: skip

COMMANDS = (
    "demo", "prepare", "train", "identify", "evaluate", "compare", "crossval", "replay",
    "simulate", "info", "fly", "reproduce", "export", "benchmark", "diagnose", "blind",
    "fleet", "watch",
)  # fmt: skip
OPTIONS = (
    "--out", "--overwrite", "--trust", "--json", "--quiet", "--data", "--logs", "--trim",
    "--engine", "--seed", "--flights", "--jobs", "--config", "--effects", "--nodes",
    "--tolerance", "--max-rows", "--timeout", "--method", "--real", "--sim", "--learn", "--cases",
    "--help", "--", "-", "-x", "--resume", "--workers", "--scheduler",
)  # fmt: skip


def case_command_line(rng, _folder, _sound):
    count = int(rng.integers(0, 8))
    more = [pick(rng, OPTIONS if rng.random() < 0.5 else WORDS) for _ in range(count)]
    words = [pick(rng, COMMANDS), *more]
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            parse(words)
    except SystemExit as end:
        return "help" if end.code == 0 else f"ended with {end.code}"
    return "parsed"


TARGETS = {
    name: globals()[f"case_{name}"]
    for name in (
        "log", "prepared", "replay", "table", "config", "bundle_bytes", "bundle_resealed",
        "results", "checkpoint", "command_line",
    )
}  # fmt: skip


def _copied(source, target):
    shutil.copytree(source, target, copy_function=shutil.copyfile)
    return target


class Sound:
    """What is changed, made once: bundles of the current schema, an estimator, a `gap.json`."""

    def __init__(self, folder):
        warnings.simplefilter("ignore")
        self.folders = {form: resealed(form, folder) for form in FORMS}
        self.bundles = {form: load_bundle(run) for form, run in self.folders.items()}
        self.models = {form: ReplayModel.of(bundle) for form, bundle in self.bundles.items()}
        self.estimator = folder / "narx"
        u = np.sin(np.arange(200.0))
        Narx(time_limit_s=2.0).fit([(u, np.convolve(u, [0.1, 0.2, 0.3])[:200])]).save(
            self.estimator
        )
        # What is compiled at its first use must not count in the time of a case.
        flight = folder / "flight.csv"
        flight.write_bytes(FLIGHT)
        for model in self.models.values():
            replay(model, flight, folder / "replayed.csv", ReplayOptions())

    @staticmethod
    def scores(run):
        """As much of `evaluate.json` as `info` reads."""
        document = json.loads((run / "bundle.json").read_text(encoding="utf-8"))
        row = {"rmse": 1.0, "one_step_rmse": None, "steady_state_rmse": 2.0}
        pooled = {"channels": {"N1_pct": row}, "ti_tt": {"passed": 1, "assessed": 2}}
        logs = [{"log": "a:left", "role": "test"}]
        weights = document["weights"]["sha256"]
        return {"weights_sha256": weights, "logs": logs, "trim": 0.1, "pooled": pooled}


class TooSlow(BaseException):
    """A case took longer than its limit."""


@contextmanager
def limited():
    """Time and memory of one case."""

    def stop(*_):
        raise TooSlow

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def run_case(name, number, seed, sound, folder):
    """Outcome of a case: a word, the name of a documented error, or the traceback of a failure."""
    rng = np.random.default_rng([seed, number])
    try:
        with limited(), warnings.catch_warnings():
            warnings.simplefilter("error")
            word = TARGETS[name](rng, folder, sound)
    except NarxcalError as error:
        return type(error).__name__, ""
    except (Exception, TooSlow):  # noqa: BLE001 -- whatever it is, it is what is looked for
        return "FAILED", traceback.format_exc()
    return word, ""


def fuzz(cases, seed, kept=None, only=(), until_s=np.inf):
    """Run cases and return counts {(target, outcome): n} and the failures [(number, traceback)]."""
    counts, failures, began = collections.Counter(), [], time.monotonic()
    names = tuple(only) or tuple(TARGETS)
    numbers = range(cases) if isinstance(cases, int) else cases
    with tempfile.TemporaryDirectory() as scratch:
        sound = Sound(Path(scratch))
        for number in numbers:
            if time.monotonic() - began > until_s:
                break
            name = names[number % len(names)]
            folder = Path(scratch) / "case"
            folder.mkdir()
            outcome, text = run_case(name, number, seed, sound, folder)
            counts[name, outcome] += 1
            if outcome == "FAILED":
                failures.append((name, number, text))
                if kept is not None:
                    shutil.copytree(folder, kept / f"{name}_{seed}_{number}", dirs_exist_ok=True)
            shutil.rmtree(folder)
    return counts, failures


def _say(text):
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--time", type=float, default=np.inf, help="seconds, at most")
    parser.add_argument("--only", nargs="+", choices=TARGETS, default=())
    parser.add_argument(
        "--keep", type=Path, default=Path("fuzz_failures"), help="of failing inputs"
    )
    options = parser.parse_args()
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    space = (LIMIT_MB + usage + 4000) * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    began = time.monotonic()
    numbers = range(options.first, options.first + options.cases)
    counts, failures = fuzz(numbers, options.seed, options.keep, options.only, options.time)
    for (name, outcome), count in sorted(counts.items()):
        _say(f"{name:16} {outcome:14} {count}")
    for name, number, text in failures[:50]:
        place = options.keep / f"{name}_{options.seed}_{number}"
        _say(f"\n{name}, case {number}, seed {options.seed}: {place}")
        _say(text)
    wall_s = time.monotonic() - began
    _say(f"seed {options.seed}: {counts.total()} cases, {len(failures)} failed, {wall_s:.0f} s")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
