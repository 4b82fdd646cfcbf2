"""Diagnoses every case of a blind test, several at a time, and never opens the key.

One folder a case: `gap.json` as `narxcal diagnose` writes it, or `failed.json`. What is there
already is not done again, so a run that was cut short goes on.
"""

from __future__ import annotations

import json
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from eval.diagnosis.blind.files import read_cases
from eval.diagnosis.diagnose import Request, diagnose_folders
from narxcal.support.errors import ConfigError, NarxcalError
from narxcal.support.files import atomic_write_text, has_schema, to_json
from narxcal.support.interrupt import is_interrupt, put_off, safe_interrupt
from narxcal.support.parallel import in_processes
from narxcal.support.progress import Progress, silent
from training.config import RunConfig

SCHEMA: Final = "narxcal.blind_answers/1"
FAILED_SCHEMA: Final = "narxcal.blind_failed/1"
ANSWERS, ANSWER, FAILED = "answers.json", "gap.json", "failed.json"


class Limits(NamedTuple):
    """How many cases at a time, and how many seconds each may take."""

    jobs: int = 1
    timeout_s: float = 900.0


class Judge(NamedTuple):
    """The simulator of cases that bring none (altered flights), and how their columns map."""

    sim: str
    config: RunConfig | None = None


class _Late(Exception):  # noqa: N818 - no error of anyone's
    """The time of a case is up."""


def run_cases(
    folder: Path,
    out: Path,
    limits: Limits | None = None,
    judge: Judge | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Diagnose all cases of `folder` that have no answer in `out` yet; returns the summary.

    A case that takes too long or fails is an answer too: none. Raises `DataError` for what is no
    blind test, and `ConfigError` for an `out` that holds something else, and where cases without
    simulated logs have no `judge`.
    """
    limits = limits or Limits()
    cases = list(read_cases(folder)["logs"])
    if judge is None and not (folder / cases[0] / "sim").is_dir():
        raise ConfigError(
            "the cases are recorded flights alone",
            file=folder,
            hint="Name the simulator by --sim: a run identified on other flights",
        )
    _check_out(out)
    out.mkdir(parents=True, exist_ok=True)
    atomic_write_text(out / ANSWERS, to_json({"schema": SCHEMA, "cases": cases}))
    left = [name for name in cases if read_answer(out, name) is None]
    done = len(cases) - len(left)
    run = partial(_run_case, folder, out, limits.timeout_s, judge)
    each = in_processes(run, left, max(1, min(limits.jobs, len(left))), ordered=False)
    for number, name in enumerate(each, start=done + 1):
        progress(number, len(cases), name)
    summary = {"schema": SCHEMA, "cases": cases, **_counted(out, cases), "resumed": done}
    atomic_write_text(out / ANSWERS, to_json(summary))
    return summary


def read_answer(out: Path, name: str) -> dict[str, Any] | None:
    """Read the answer to a case, its failure included; None where there is none yet."""
    for file in (out / name / ANSWER, out / name / FAILED):
        if file.is_file():
            document: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
            return document
    return None


def _check_out(out: Path) -> None:
    empty = not out.exists() or (out.is_dir() and not any(out.iterdir()))
    if not empty and not has_schema(out / ANSWERS, SCHEMA):
        raise ConfigError(
            f"output folder {out} holds other content and is not written to",
            hint="Choose another name, or that of an earlier `blind run` to go on with it",
        )


def _run_case(folder: Path, out: Path, timeout_s: float, judge: Judge | None, name: str) -> str:
    """Diagnose one case and write what came of it; runs in a process of its own."""
    began = time.perf_counter()
    try:
        with safe_interrupt(), _at_most(timeout_s):
            found = {**diagnose_folders(_request(folder / name, judge)).document}
        took = time.perf_counter() - began
        if took > timeout_s:
            found = _failure("timeout", f"took {took:.0f} s of {timeout_s:g} s")
    except _Late:
        found = _failure("timeout", f"was stopped after {timeout_s:g} s")
    except Exception as error:  # one case that breaks must not end all the others
        if is_interrupt(error):
            raise KeyboardInterrupt from error
        refused = isinstance(error, NarxcalError)
        said = str(error) if refused else f"{type(error).__name__}: {error}"
        found = _failure("refused" if refused else "error", said)
    found["seconds"] = round(time.perf_counter() - began, 2)
    file = FAILED if found["schema"] == FAILED_SCHEMA else ANSWER
    atomic_write_text(out / name / file, to_json(found))
    return name


def _request(case: Path, judge: Judge | None) -> Request:
    if judge is not None:
        return Request(case / "real", judge.sim, judge.config)
    return Request(
        real=case / "real",
        sim=str(case / "sim"),
        held_real=case / "real_heldout",
        held_sim=str(case / "sim_heldout"),
    )


def _failure(kind: str, reason: str) -> dict[str, Any]:
    return {"schema": FAILED_SCHEMA, "kind": kind, "reason": reason}


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Stop the block when its time is up, where the system can do that.

    Elsewhere (no alarm, or not in the main thread) the block ends by itself and is late then.
    """
    main = threading.current_thread() is threading.main_thread()
    if not (main and hasattr(signal, "setitimer")):
        yield
        return
    before = signal.signal(signal.SIGALRM, put_off(_stop))
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _stop(*_: object) -> None:
    raise _Late


def _counted(out: Path, cases: list[str]) -> dict[str, Any]:
    answers = {name: read_answer(out, name) or {} for name in cases}
    ends = Counter(answer.get("kind", "answered") for answer in answers.values())
    return {
        "ends": dict(sorted(ends.items())),
        "seconds": {name: answer.get("seconds") for name, answer in answers.items()},
    }
