"""The figures that a change of the code may move: `make figures`, before and after the change.

Commands are run as a user runs them, each in a process of its own, and their JSON is read. `--fast`
leaves out all but one fold of the Citation and of AGTF30, the largest public set, speeds and the
blind test. With `--against` an earlier output, the two stand side by side, and the exit code is 1
where a result moved by more than 1 % or a transient less passes; a speed is shown and judges
nothing.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from eval.benchmarks import Row, public_sets, speed

_SHARED: Final = Path(__file__).resolve().parents[3] / "shared" / "data"
_PARTS: Final = ("demo", "jetcat", "citation2", "agtf30", "public", "speed", "blind")  # slow last
# Patterns of the recordings of a configuration; the first is the one that it holds out itself.
_RECORDINGS: Final = {
    "jetcat": ("*20230109*", "*20230222*"),
    "citation2": ("*flight2*", "*flight1*"),
    "agtf30": ("flight_3*", "flight_1*", "flight_2*"),
}
_FOLDERS: Final = {"jetcat": "flights", "citation2": "flights", "agtf30": "agtf30"}
_TRIMMED: Final = {"citation2": 0.2}
_BLIND: Final = ("--cases", "8", "--flights", "3", "--held-out", "2", "--seed", "25")
_SPEED: Final = "speed: "
_PASSED: Final = "passed"  # a single transient less is shown, however small its share
_MOVED_PCT: Final = 1.0  # a simpler program may cost so much of a figure, if it is listed

Figures = Iterator[tuple[str, float | None]]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, write flat JSON `{name: number}`, compare; 1 where a result moved."""
    parser = argparse.ArgumentParser(prog="python -m eval.benchmarks.figures", description=__doc__)
    parser.add_argument("--fast", action="store_true", help="a part of it, in some minutes")
    parser.add_argument("--parts", nargs="+", choices=_PARTS, help="these alone")
    parser.add_argument("--data", type=Path, default=_SHARED, help="holds flights, agtf30, bench")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="else standard output")
    parser.add_argument("--against", type=Path, metavar="FILE.json", help="figures of before")
    options = parser.parse_args(arguments)
    found: dict[str, float] = {}
    for part in options.parts or (_PARTS[:-2] if options.fast else _PARTS):
        began = time.perf_counter()
        new = dict(_measured(part, options.data, fast=options.fast))
        found |= {name: value for name, value in new.items() if value is not None}
        sys.stderr.write(f"{part}: {time.perf_counter() - began:.0f} s\n")
        if options.out is not None:  # what is there stays, should a later part fail
            options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if options.out is None:
        sys.stdout.write(json.dumps(found, indent=1) + "\n")
    if options.against is None:
        return 0
    return 1 if compare(json.loads(options.against.read_text(encoding="utf-8")), found) else 0


def compare(before: Mapping[str, float], after: Mapping[str, float]) -> list[str]:
    """Print both side by side; returns the results that moved by more than 1 %.

    A name on one side alone is shown with nan and is not judged: parts may have been left out.
    """
    moved = []
    for name in {**before, **after}:
        old, new = before.get(name, math.nan), after.get(name, math.nan)
        change_pct = 0.0 if old == new else 100.0 * (new - old) / abs(old) if old else math.inf
        lost = name.endswith(_PASSED) and new < old
        if (lost or abs(change_pct) > _MOVED_PCT) and not name.startswith(_SPEED):
            moved.append(name)
        mark = "  <--" if name in moved else ""
        sys.stderr.write(f"{name:<64} {old:>12.6g} {new:>12.6g} {change_pct:>+9.3g} %{mark}\n")
    return moved


def _measured(part: str, data: Path, *, fast: bool) -> Figures:
    if part == "public":
        yield from _rows(public_sets.rows(data / "bench", public_sets.NAMES[: 2 if fast else None]))
    elif part == "speed":
        yield from _rows([*speed.kernel_rows(), *speed.replay_rows()])
    else:
        with tempfile.TemporaryDirectory() as folder:
            if part == "demo":
                document = _narxcal("demo", "--out", Path(folder) / "demo")
                yield from _judged("demo", document["evaluation"])
            elif part == "blind":
                yield from _blind(Path(folder))
            else:
                for held_out in _RECORDINGS[part][: 1 if fast and part != "jetcat" else None]:
                    yield from _held_out(part, held_out, data, Path(folder))


def _held_out(config: str, test: str, data: Path, folder: Path) -> Figures:
    """Figures of one recording by a model of all others."""
    train = [pattern for pattern in _RECORDINGS[config] if pattern != test]
    text = (files("configs") / f"{config}.toml").read_text(encoding="utf-8")
    for key, patterns in (("train", train), ("test", [test])):
        text = re.sub(rf"^{key} = .*$", f"{key} = {json.dumps(patterns)}", text, flags=re.MULTILINE)
    name = f"{config} {test.strip('*_')}"
    file, run = folder / f"{name}.toml", folder / name
    file.write_text(text, encoding="utf-8")
    _narxcal("train", file, "--out", run, "--data", data / _FOLDERS[config])
    bundle = json.loads((run / "bundle.json").read_text(encoding="utf-8"))
    yield f"{_SPEED}{name}, training, s", bundle["training"]["wall_s"]
    yield from _judged(name, _narxcal("evaluate", run))
    if config in _TRIMMED:
        trim = str(_TRIMMED[config])
        yield from _judged(f"{name} trim {trim}", _narxcal("evaluate", run, "--trim", trim))


def _judged(name: str, evaluation: Mapping[str, Any]) -> Figures:
    for key in (_PASSED, "assessed", "mean_relative_Ti_pct", "mean_relative_Tt_pct"):
        yield f"{name}, Ti and Tt, {key}", evaluation["pooled"]["ti_tt"][key]
    for channel, scores in evaluation["pooled"]["channels"].items():
        yield f"{name}, {channel}, RMSE", scores["rmse"]
        yield f"{name}, {channel}, largest error, %", scores["max_rel_pct"]


def _blind(folder: Path) -> Figures:
    cases, answers = folder / "cases", folder / "answers"
    _narxcal("blind", "make", "--out", cases, "--jobs", 2, *_BLIND)
    _narxcal("blind", "run", cases, "--out", answers, "--jobs", 2)
    for row in _narxcal("blind", "score", cases, answers, "--secret", _BLIND[-1])["table"]:
        lead = _SPEED if row["unit"] == "s" and row["group"] == "cost" else ""
        yield f"{lead}blind, {row['group']}, {row['name']}", row["value"]


def _rows(rows: Sequence[Row]) -> Figures:
    for row in rows:
        lead = _SPEED if row.group in {"speed", "replay"} or row.unit == "CPU s" else ""
        yield f"{lead}{row.name}, {row.unit}", None if math.isnan(row.value) else row.value


def _narxcal(*arguments: object) -> Any:
    """What a command prints with --json; 1, a tolerance was missed, is good."""
    command = [sys.executable, "-m", "narxcal", *map(str, arguments), "--json"]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)  # noqa: S603  (our own command)
    if done.returncode not in {0, 1}:
        raise SystemExit(done.returncode)
    return json.loads(done.stdout)


if __name__ == "__main__":
    sys.exit(main())
