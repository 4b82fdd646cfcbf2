"""What flight cards are good for, on virtual engines of given seeds.

    python -m eval.benchmarks.cards information --seed 42021 --cases 4
    python -m eval.benchmarks.cards gaps --seed 42011 --cases 60

`information` trains a run on three flights of eight minutes of each engine, and measures what its
parameters' entropy falls by, in nats, by the card of 20 minutes as a pilot flies it, and by an hour
and by 20 minutes of both shipped profiles.

`gaps` draws blind cases (`narxcal blind`), diagnoses each, and where the verdict is ambiguous or
undetermined, as it always is of what one short flight shows, flies the same engine with the same
effect again: once the card that `narxcal card` makes of its gap.json, and once as many minutes of
the profile of its other flights, on one day. Each is diagnosed together with the flights before.
Resolved is a verdict of effects or of none; right is one that names what acts, all of it or a part,
and nothing else. Left out are cases whose effects make less than 5 % of the gap, and engines whose
input is the fuel flow: the pilot has a lever.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import pandas as pd

from eval.card import Wanted, calibration_card
from eval.diagnosis.applied import EMULATOR, signals_from_json, write_emulator
from eval.diagnosis.blind.cases import BlindPlan, Case, draw_cases
from eval.diagnosis.blind.files import write_log
from eval.diagnosis.blind.make import sized
from eval.diagnosis.blind.outcome import FLOOR, Outcome
from eval.diagnosis.blind.score import rate
from eval.diagnosis.blind.truth import Content, Flight, Specimen, hidden_windows
from eval.diagnosis.diagnose import Answer, Request, diagnose_folders
from eval.diagnosis.separate import separation_card
from eval.information import Experiment, of_training
from narxcal.flight_test.fly import fly
from narxcal.flight_test.moves import FlightCard, Limits
from narxcal.flight_test.pilot import STYLES
from narxcal.flight_test.plan import FlightPlan, plan_card, plan_flight, seeded
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import NarxcalError
from narxcal.support.files import to_json
from narxcal.support.parallel import in_processes
from training.config import SCHEMA, RunConfig
from training.pipeline import calibrate, read_split

_UNDECIDED: Final = ("ambiguous", "unknown")
ENGINES: Final = ("business_jet", "single_aisle")
_RATE_HZ: Final = 8.0
_SWITCHES: Final = ("Approach", "NAI", "WAI")  # that the pilot may set
_NEXT: Final = 100  # number of the next flight, which is none of those before
_LIMITS: Final[dict[str, Any]] = {
    "schema": "narxcal.limits/1",
    "altitude_ft": (2000.0, 35_000.0),
    "mach": (0.3, 0.75),
    "climb_ft_min": 4000.0,
    "lever": (0.0, 85.0),
    "lever_per_s": 120.0,
    "settle_s": 10.0,
    "hold_s": 8.0,
    "inputs": {"ECS": 1.0},
}


@dataclass(frozen=True, eq=False)
class Trial:
    """A case with what acts in it, and the folder of its logs."""

    specimen: Specimen
    content: Content
    folder: Path

    @classmethod
    def flown(cls, case: Case, plan: BlindPlan, folder: Path) -> Trial:
        """Fly the case."""
        specimen = Specimen(case, plan)
        flights = [specimen.flight(k) for k in range(plan.flights + plan.held_out)]
        held = flights[plan.flights :]
        content = sized(specimen, held, [specimen.simulated(one) for one in held])
        found = cls(specimen, content, folder)
        for one in flights[: plan.flights]:
            found.record(one)
        return found

    def record(self, flight: Flight) -> None:
        """Write what is simulated and recorded of a flight."""
        name = f"flight_{flight.number}.csv.gz"
        write_log(self.folder / "sim" / name, self.specimen.simulated(flight))
        write_log(self.folder / "real" / name, self.specimen.both(flight, self.content)[1])

    def diagnosed(self, inputs: Mapping[str, Any] | None = None) -> Answer:
        """Diagnose all flights, together with a next one of these inputs, which is not kept."""
        if inputs is not None:
            time_s = inputs["time_s"]
            windows = hidden_windows(seeded(self.specimen.case.number), float(time_s[-1]))
            self.record(Flight(_NEXT, dict(inputs), windows))
        found = diagnose_folders(Request(self.folder / "real", str(self.folder / "sim")))
        for side in ("sim", "real"):
            (self.folder / side / f"flight_{_NEXT}.csv.gz").unlink(missing_ok=True)
        return found


def judged(true: Sequence[str], document: Mapping[str, Any]) -> dict[str, Any]:
    """Whether a diagnosis is resolved, and right, where effects called `true` act."""
    found = Outcome("", {}, document)
    resolved, said = found.verdict not in _UNDECIDED, {*found.named_set}
    return {
        "verdict": [found.verdict, *found.named_set],
        "resolved": resolved,
        "right": resolved and bool(said) and said <= {*true},
    }


def tried(plan: BlindPlan, minutes: float, case: Case) -> dict[str, Any]:
    """What a case comes to, and where it is undecided what it comes to after each next flight."""
    with TemporaryDirectory() as place:
        trial = Trial.flown(case, plan, Path(place))
        before = trial.diagnosed()
        true = [dose.scale.name for dose in trial.content.doses]
        own = judged(true, before.document)
        facts: dict[str, Any] = {
            "case": case.name, "engine": case.engine, "style": case.style, "true": true,
            "before": own,
        }  # fmt: skip
        if own["resolved"]:
            return facts
        seed = int(np.random.default_rng([plan.seed, case.number]).integers(2**31))
        aircraft = "business_jet" if case.engine.startswith("lumped") else case.engine
        wanted = FlightPlan(style=case.style, duration_s=60.0 * minutes, rate_hz=plan.rate_hz,
                            aircraft=aircraft)  # fmt: skip
        standard = plan_flight(wanted, seed)["left"]
        facts["standard"] = judged(true, trial.diagnosed(standard).document)
        signals = signals_from_json(before.document["quality"]["signals"])
        switches = [name for name in _SWITCHES if name in signals.active]
        day = float(standard["dT_C"].mean())
        limits = Limits.parse({**_LIMITS, "dT_C": day, "switches": switches})
        try:
            card = _card(trial.folder, before, Wanted(limits, minutes))
            flown = plan_card(FlightCard.parse(card), wanted, seed)["left"]
            found = judged(true, trial.diagnosed(flown).document)
        except NarxcalError as error:  # no card, or one that this engine does not survive
            return {**facts, "card": {"resolved": False, "right": False, "verdict": [str(error)]}}
        chances = [row["after"] for row in card["expected"]]
        steps = [" ".join(filter(None, (one["name"], one["switch"]))) for one in card["steps"]]
        return {**facts, "chances": chances, "steps": steps, "card": found}


def _card(folder: Path, found: Answer, wanted: Wanted) -> dict[str, Any]:
    """The document of the card that a diagnosis gives."""
    (folder / EMULATOR).mkdir()
    write_emulator(folder / EMULATOR, found.emulator)
    file = folder / "gap.json"
    file.write_text(to_json(found.document), encoding="utf-8")
    return separation_card(file, wanted).document()


def information(minutes: float, seed: int) -> dict[str, Any]:
    """Nats that the card and the profiles add to what a run of one engine knows."""
    table: dict[str, Any] = {
        "engine": ENGINES[seed % 2], "engines": ["left"], "flights": 3, "seed": seed,
        "plan": {"style": "enriched", "duration_s": 480.0, "rate_hz": _RATE_HZ},
    }  # fmt: skip
    scenario = FlightScenario.parse(table)
    with TemporaryDirectory() as place:
        for flight in (1, 2, 3):
            (log,) = fly(scenario, flight)
            pd.DataFrame(dict(log.recorded)).to_csv(Path(place) / f"{log.name}.csv", index=False)
        logs = {"folder": place, "files": ["flight_*.csv"]}
        config = RunConfig.parse({"schema": SCHEMA, "logs": logs})
        split, _ = read_split(config, config.logs.resolve(Path(place)))
        bundle = calibrate(config, Path(place), split)
        limits = Limits.parse(_LIMITS | {"inputs": {}})
        card = calibration_card(bundle, Wanted(limits, minutes)).document()
        experiment = Experiment(bundle, limits, card["lever"])
        before = np.eye(len(experiment.unit)) + of_training(experiment, None)

    def nats(flown: Mapping[str, FloatArray]) -> float:
        inputs = np.stack([flown[name] for name in bundle.calibration.input_names], axis=1)
        after = before + experiment.information_of(inputs).information
        return 0.5 * float(np.linalg.slogdet(after)[1] - np.linalg.slogdet(before)[1])

    plan = FlightPlan(aircraft=scenario.engine, rate_hz=_RATE_HZ)
    found = {"card": nats(plan_card(FlightCard.parse(card), plan, seed)["left"])}
    for style in STYLES:
        for length in (60.0, minutes):
            change = {"style": style, "duration_s": 60.0 * length}
            flown = plan_flight(plan.model_copy(update=change), seed)["left"]
            found[f"{style} {length:g}"] = nats(flown)
    return {"seed": seed, "engine": scenario.engine, "predicted": card["information_nats"], **found}


def cases(plan: BlindPlan) -> Iterator[Case]:
    """Draw the cases whose effects are to be named, and that a pilot can fly."""
    for one in draw_cases(plan):
        if one.effects and one.share >= FLOOR and one.engine != "lumped_fuel":
            yield one


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line of JSON per engine or case; of gaps then counts with 95 % intervals."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("what", choices=("information", "gaps"))
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, required=True)
    parser.add_argument("--flights", type=int, default=1, help="of a case before the next one")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    run: Any = partial(information, options.minutes)
    items: list[Any] = [options.seed + k for k in range(options.cases)]
    if options.what == "gaps":
        plan = BlindPlan(cases=options.cases, seed=options.seed, flights=options.flights,
                         held_out=1, rate_hz=_RATE_HZ)  # fmt: skip
        run, items = partial(tried, plan, options.minutes), list(cases(plan))
    rows = []
    for row in in_processes(run, items, options.jobs, ordered=False):
        sys.stdout.write(json.dumps(row) + "\n")
        sys.stdout.flush()
        rows.append(row)
    for arm, what in product(("card", "standard"), ("resolved", "right")):
        found = rate(row[arm][what] for row in rows if "standard" in row)
        interval = f"({found.low:.2f} to {found.high:.2f})"
        sys.stdout.write(f"{arm}: {what} {found.hits} of {found.of} {interval}\n" * bool(found.of))


if __name__ == "__main__":
    main()
