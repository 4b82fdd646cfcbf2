"""Makes the cases of a blind test: logs of both engines in a folder each, and the sealed key.

Sizes of effects come to a wanted share of the gap,

    g = 1 - MSE(recorded - (simulated with the effect)) / MSE(recorded - simulated)

The MSE of a channel counts over the square of its simulated range, channels alike. The true budget
is a Shapley mean (L. S. Shapley, 1953) over the orders in which effects, build and offsets enter,
on re-simulations without noise, `offsets` being the mean error of the recording in each flight:

    share_k = sum_S |S|! (n - |S| - 1)! / n! (v(S) - v(S + k)) / MSE(recorded - simulated)

where v(S) is the MSE of what is true less the simulator with the causes S. What they leave is
unexplained: another structure, and what is in no library; the rest of the recording's error is
noise. All shares sum to 1; one below 0 opposes the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from eval.diagnosis.blind.cases import BlindPlan, Case, Dose, draw_cases
from eval.diagnosis.blind.files import (
    CASES,
    KEY,
    KEY_SCHEMA,
    SCHEMA,
    salt_of,
    sealed,
    write_log,
)
from eval.diagnosis.blind.truth import NOTHING, Channels, Content, Flight, Specimen, outputs_of
from narxcal.support.arrays import FloatArray
from narxcal.support.csv_text import log_csv
from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_write_bytes, atomic_write_text, to_json
from narxcal.support.parallel import in_processes
from narxcal.support.progress import Progress, silent

_TRIES: Final = 3
_CLOSE: Final = 0.1  # of the energy: the next size will do
_LEAST: Final = 1e-3  # of the energy aimed at: the size does nothing yet
_SMALLEST: Final = 0.03  # of the first size
Measure = Callable[[float], float]
Logs = Sequence[Channels]  # of one engine, flight by flight


def ranges(simulated: Logs) -> dict[str, float]:
    """Range of each output over all simulated flights."""
    return {
        name: max(max(np.nanmax(s[name]) for s in simulated) - low, 1e-9)
        for name in outputs_of(simulated[0])
        for low in [min(np.nanmin(s[name]) for s in simulated)]
    }


def energy(one: Channels, other: Channels, spans: Mapping[str, float]) -> float:
    """Mean over the outputs of the squared difference, in squares of their ranges."""
    return float(np.mean(_squares(one, other, spans)))


def _squares(one: Channels, other: Channels, spans: Mapping[str, float]) -> FloatArray:
    """Mean squared difference of each output, in squares of its range: `(outputs,)`."""
    return np.array([np.nanmean((one[n] - other[n]) ** 2) / spans[n] ** 2 for n in spans])


def gap_share(recorded: Logs, simulated: Logs, with_it: Logs) -> float:
    """Share of the squared gap that the true content takes away: `with_it` is simulated with it."""
    spans = ranges(simulated)
    before = sum(energy(r, s, spans) for r, s in zip(recorded, simulated, strict=True))
    after = sum(energy(r, t, spans) for r, t in zip(recorded, with_it, strict=True))
    return 1.0 - after / before if before > 0.0 else 0.0


def sized(specimen: Specimen, flights: Sequence[Flight], simulated: Logs) -> Content:
    """Give the case's content the sizes that come to its share on some flights.

    Several effects get equal parts. A share that the largest size does not make is left at that.
    """
    case = specimen.case
    if case.kind == "null":
        return NOTHING
    spans = ranges(simulated)
    recorded = [specimen.both(flight, NOTHING)[1] for flight in flights]
    rest = sum(energy(r, s, spans) for r, s in zip(recorded, simulated, strict=True))
    wanted = rest * case.share / (1.0 - case.share)

    def measured(content: Content) -> float:
        # By itself: what it shares with the errors of the base would make it look larger.
        with_it = [specimen.simulated(flight, content) for flight in flights]
        return sum(energy(t, s, spans) for t, s in zip(with_it, simulated, strict=True))

    if case.strange is not None:
        size = size_for(lambda s: measured(Content(strange=s)), wanted, case.strange[3:5])
        return Content(strange=size)
    doses = []
    for scale, sign in zip(case.effects, case.signs, strict=True):

        def alone(size: float, dose: Dose = Dose(scale, sign)) -> float:  # noqa: B008 - bound now
            return measured(Content((dose._replace(size=dose.size * size),)))

        part = wanted / len(case.effects)
        doses.append(Dose(scale, sign * size_for(alone, part, (scale.first, scale.most))))
    return Content(tuple(doses))


def size_for(measured: Measure, wanted: float, sizes: tuple[float, float]) -> float:
    """Size, up to the second of `sizes`, whose energy is as wanted: few tries from the first.

    Energies go with a power of the size, about the second; the power is taken from the last two.
    """
    size, most = sizes
    least = _SMALLEST * size
    power, last = 2.0, (0.0, 0.0)
    for _ in range(_TRIES):
        made = measured(size)
        if made < _LEAST * wanted:
            if size >= most:
                return most
            size = min(3.0 * size, most)
            continue
        if last[1] > 0.0 and abs(math.log(size / last[0])) > 0.02:
            power = math.log(made / last[1]) / math.log(size / last[0])
        last = (size, made)
        size = size * (wanted / made) ** (1.0 / min(max(power, 0.7), 4.0))
        size = min(max(size, least), most)
        if abs(math.log(wanted / made)) < _CLOSE:
            break
    return size


def budget(
    specimen: Specimen,
    flights: Sequence[Flight],
    content: Content,
    simulated: Logs,
    real: Sequence[tuple[Channels, Channels]],
) -> dict[str, dict[str, Any]]:
    """Give the true budget of a case on some flights: cause -> its share, and that by channel.

    Causes are the effects by name, `build`, `offsets`, `noise` and `unexplained`. `real` are true
    and recorded channels, `simulated` those of the simulator as it is.
    """
    spans = ranges(simulated)
    players = [*(dose.scale.name for dose in content.doses), "build", "offsets"]
    shifted = [{n: t[n] + np.nanmean(r[n] - t[n]) for n in spans} for t, r in real]
    models: dict[frozenset[str], Logs] = {frozenset(): simulated}

    def left(entered: frozenset[str]) -> FloatArray:
        inside = entered - {"offsets"}
        if inside not in models:
            doses = tuple(dose for dose in content.doses if dose.scale.name in inside)
            built = "build" in inside
            models[inside] = [specimen.simulated(f, Content(doses), built=built) for f in flights]
        true = [each[0] for each in real] if "offsets" in entered else shifted
        each = [_squares(t, m, spans) for t, m in zip(true, models[inside], strict=True)]
        return np.asarray(np.mean(each, axis=0))

    values = {
        frozenset(s): left(frozenset(s))
        for size in range(len(players) + 1)
        for s in combinations(players, size)
    }
    found = {name: _shapley(name, values, len(players)) for name in players}
    found["unexplained"] = values[frozenset(players)]
    whole = [_squares(r[1], s, spans) for r, s in zip(real, simulated, strict=True)]
    total = np.mean(whole, axis=0)
    found["noise"] = total - values[frozenset()]
    scale = max(float(total.sum()), 1e-300)
    return {
        name: {
            "share": float(each.sum()) / scale,
            "channels": dict(zip(spans, (each / scale).tolist(), strict=True)),
        }
        for name, each in found.items()
    }


def _shapley(name: str, values: Mapping[frozenset[str], FloatArray], n: int) -> FloatArray:
    own = [
        (without, math.factorial(len(without)) * math.factorial(n - len(without) - 1))
        for without in values
        if name not in without
    ]
    parts = [count * (values[s] - values[s | {name}]) for s, count in own]
    return np.asarray(np.sum(parts, axis=0) / math.factorial(n))


_SIZED_ON = 2  # flights: their days differ


class Made(NamedTuple):
    """A case that is made: its row of the key, and log -> SHA-256."""

    name: str
    row: dict[str, Any]
    logs: dict[str, str]


def make_cases(folder: Path, plan: BlindPlan, jobs: int = 1) -> Iterator[Made]:
    """Make all cases of a plan in `folder`, several at a time; their bytes depend on it alone.

    Raises `ModelError` naming the case that cannot be flown.
    """
    cases = draw_cases(plan)
    return in_processes(partial(make_case, folder, plan), cases, min(jobs, len(cases)))


def write_key(
    folder: Path, plan: BlindPlan, secret: str, cases: Iterable[Made], progress: Progress = silent
) -> dict[str, Any]:
    """Make `cases`, seal their key by `secret`, and write the list of them, which is returned.

    The list tells names, flights and digests, and nothing of what is in a case.
    """
    rows: dict[str, Any] = {}
    logs: dict[str, dict[str, str]] = {}
    for number, made in enumerate(cases, start=1):
        rows[made.name], logs[made.name] = made.row, made.logs
        progress(number, plan.cases, made.name)
    listed = {"schema": SCHEMA, "plan": plan.model_dump(exclude={"seed"}), "logs": logs}
    key = {"schema": KEY_SCHEMA, "plan": plan.model_dump(), "cases": rows}
    atomic_write_bytes(folder / KEY, sealed(key, secret, salt_of(listed)))
    atomic_write_text(folder / CASES, to_json(listed))
    return listed


def make_case(folder: Path, plan: BlindPlan, case: Case) -> Made:
    """Fly one case and write its logs; runs in a process of its own."""
    try:
        return made_from(folder, plan, Specimen(case, plan))
    except ModelError as error:
        raise ModelError(
            error.problem, file=case.name, row=error.row, hint="Take another --seed"
        ) from None


def made_from(folder: Path, plan: BlindPlan, specimen: Specimen) -> Made:
    """Write the logs of a specimen."""
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


def _written(folder: Path, flights: int, simulated: Logs, recorded: Logs) -> dict[str, str]:
    found = {}
    for number, (sim, real) in enumerate(zip(simulated, recorded, strict=True)):
        held = "" if number < flights else "_heldout"
        for name, channels in (("sim", sim), ("real", real)):
            log = f"{name}{held}/flight_{number}.csv.gz"
            found[log] = write_log(folder / log, log_csv(channels, 8))
    return found


def _facts(case: Case, content: Content, flights: Sequence[Flight]) -> dict[str, Any]:
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
