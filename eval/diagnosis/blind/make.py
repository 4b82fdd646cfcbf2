"""Makes the cases of a blind test: logs of both engines in a folder each, and the sealed key."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from eval.diagnosis.blind.cases import BlindPlan, Case, draw_cases
from eval.diagnosis.blind.files import (
    CASES,
    FOLDERS,
    KEY,
    KEY_SCHEMA,
    SCHEMA,
    salt_of,
    sealed,
    write_log,
)
from eval.diagnosis.blind.shares import budget, gap_share, sized
from eval.diagnosis.blind.truth import Channels, Content, Specimen
from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_write_bytes, atomic_write_text
from narxcal.support.parallel import in_processes
from narxcal.support.progress import Progress, silent

_SIZED_ON = 2  # flights: their days differ


class Made(NamedTuple):
    """A case that is made: its row of the key, and log -> SHA-256."""

    name: str
    row: dict[str, Any]
    logs: dict[str, str]


def make_cases(
    folder: Path, plan: BlindPlan, secret: str, jobs: int = 1, progress: Progress = silent
) -> dict[str, Any]:
    """Make all cases of a plan in `folder`, with the key sealed by `secret`; returns the list.

    The bytes depend on plan and secret alone. The list tells names, flights and digests, and
    nothing of what is in a case. Raises `ModelError` naming the case that cannot be flown.
    """
    made = _all_made(folder, plan, draw_cases(plan), jobs)
    return write_key(folder, plan, secret, made, progress)


def write_key(
    folder: Path, plan: BlindPlan, secret: str, cases: Iterable[Made], progress: Progress = silent
) -> dict[str, Any]:
    """Make `cases`, seal their key by `secret`, and write the list of them, which is returned."""
    rows: dict[str, Any] = {}
    logs: dict[str, dict[str, str]] = {}
    for number, made in enumerate(cases, start=1):
        rows[made.name], logs[made.name] = made.row, made.logs
        progress(number, plan.cases, made.name)
    listed = {"schema": SCHEMA, "plan": plan.model_dump(exclude={"seed"}), "logs": logs}
    key = {"schema": KEY_SCHEMA, "plan": plan.model_dump(), "cases": rows}
    atomic_write_bytes(folder / KEY, sealed(key, secret, salt_of(listed)))
    atomic_write_text(folder / CASES, json.dumps(listed, indent=1) + "\n")
    return listed


def _all_made(folder: Path, plan: BlindPlan, cases: Sequence[Case], jobs: int) -> Iterator[Made]:
    return in_processes(partial(make_case, folder, plan), cases, min(jobs, len(cases)))


def make_case(folder: Path, plan: BlindPlan, case: Case) -> Made:
    """Fly one case and write its logs; runs in a process of its own."""
    try:
        return made_from(folder, plan, Specimen(case, plan))
    except ModelError as error:
        raise ModelError(
            error.problem, file=case.name, row=error.row, hint="Take another --seed"
        ) from None


def made_from(folder: Path, plan: BlindPlan, specimen: Any) -> Made:
    """Write the logs of a specimen; `Specimen` says what it has to be able to."""
    case = specimen.case
    flights = [specimen.flight(number) for number in range(plan.flights + plan.held_out)]
    simulated = [specimen.simulated(flight) for flight in flights]
    # Sizes and shares are those on flights that the diagnosis does not see.
    content = sized(specimen, flights[-_SIZED_ON:], simulated[-_SIZED_ON:])
    real = [specimen.both(flight, content) for flight in flights]
    recorded = [each[1] for each in real]
    held = slice(plan.flights, None)
    listed = [specimen.simulated(flight, content) for flight in flights[held]]
    row = {
        **_facts(case, content, flights),
        "gap_share": gap_share(recorded[held], simulated[held], listed),
        "budget": budget(specimen, flights[held], content, simulated[held], real[held]),
    }
    return Made(case.name, row, _written(folder / case.name, plan.flights, simulated, recorded))


def _written(
    folder: Path, flights: int, simulated: Sequence[Channels], recorded: Sequence[Channels]
) -> dict[str, str]:
    """Write all logs of a case; returns log -> SHA-256."""
    found = {}
    for number, both in enumerate(zip(simulated, recorded, strict=True)):
        names = FOLDERS[:2] if number < flights else FOLDERS[2:]
        for name, channels in zip(names, both, strict=True):
            log = f"{name}/flight_{number}.csv.gz"
            found[log] = write_log(folder / log, channels)
    return found


def _facts(case: Case, content: Content, flights: Sequence[Any]) -> dict[str, Any]:
    """The row of the key, but for what is measured."""
    strange = case.strange
    return {
        "kind": case.kind,
        "style": case.style,
        "engine": case.engine,
        "effects": [dose.row() for dose in content.doses],
        "outside": None
        if strange is None
        else {"id": strange.id, "size": content.strange, "like": list(strange.like)},
        "base": {**case.base._asdict(), "differs": case.base.differs},
        "aimed_share": case.share,
        "windows_s": [list(flight.windows) for flight in flights],
    }
