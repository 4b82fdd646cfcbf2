"""What the two open Citation II flights hold that no channel records.

    python -m eval.gap.flights_study --data ../shared/data/flights --out docs

For either flight the simulator is a calibration of the other one; both engines are looked at. It
writes `citation_gap.md` and a figure per flight beside it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from data_prep.log import Log
from eval.gap.flights_page import write_page
from eval.gap.flights_steps import FlightStudy, Judged, followed, level, steps
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.config import RunConfig, load_config
from training.crossval import leave_one_flight_out
from training.gap.path_windows import Windows
from training.gap.window_search import Options
from training.gap.windows import find_windows
from training.pipeline import calibrate, calibration_for, configured_files, prepare_logs
from training.records import Split

BEFORE_S, AFTER_S = 10.0, 1.0  # how long the engine is unsettled after its fuel flow moved
MOVED = 0.04  # of the range of fuel flow
NOISE = {"N1_pct": 0.1, "N2_pct": 0.1, "EGT_C": 1.0}
DRAWS = 12


def main(arguments: Sequence[str] | None = None) -> int:
    """Study all flights of the folder and write the page."""
    parser = argparse.ArgumentParser(prog="python -m eval.gap.flights_study", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/flights"))
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--config", default="citation2.toml")
    options = parser.parse_args(arguments)
    config, base = load_config(options.config)
    moved = config.logs.model_copy(update={"folder": str(options.data.resolve())})
    config = config.model_copy(update={"logs": moved})
    write_page(studies(config, base), options.out)
    return 0


def studies(config: RunConfig, base: Path) -> list[FlightStudy]:
    """Every flight in turn, simulated by a calibration of the others.

    Where windows are confirmed, the others are judged again by a calibration of that flight with
    the windows taken out.
    """
    logs = prepare_logs(config, configured_files(config, base))
    found, again = [], []
    for plan in leave_one_flight_out(logs, config.events):
        train, test = ([part.log for part in parts] for parts in (plan.train, plan.test))
        judged = judge(config, base, train, test)
        found.append(study(f"{_flight(test)}, by a model of {_flight(train)}", judged))
        if found[-1].confirmed:
            cleaned = [cleaned_log(log, found[-1], e) for e, log in enumerate(test)]
            title = f"{_flight(train)}, by a model of {_flight(test)} with its windows taken out"
            again.append(study(title, judge(config, base, cleaned, train)))
    return [*found, *again]


def cleaned_log(log: Log, found: FlightStudy, e: int) -> Log:
    """The log of engine `e` without what its windows shift."""
    shape = followed(found.windows.on[e], found.judged.dt_s)
    sizes = level(found.judged.gap[e], [shape])[0]
    shape = np.concatenate([shape, np.repeat(shape[-1:], len(log) - len(shape))])
    names = found.judged.outputs
    return log.with_channels(
        {name: log[name] - shape * size for name, size in zip(names, sizes, strict=True)}
    )


def _flight(logs: Sequence[Log]) -> str:
    return ", ".join(dict.fromkeys(Path(log.source.file).name.split(".")[0] for log in logs))


def judge(config: RunConfig, base: Path, train: Sequence[Log], test: Sequence[Log]) -> Judged:
    """Free runs over the whole logs of `test` with a calibration of `train`."""
    bundle = calibrate(config, base, Split(tuple(train), (), ()))
    length = min(len(log) for log in test)
    real, sim, fuel = [], [], []
    for log in test:
        own = calibration_for(bundle.calibration, log)
        measured = log.matrix(own.output_names)
        sim.append(own.simulate(log.matrix(own.input_names), measured[0])[:length])
        real.append(measured[:length])
        fuel.append(log[config.events.driver][:length])
    engines = tuple(log.source.engine for log in test)
    names = bundle.calibration.output_names
    return Judged(engines, names, test[0].dt_s, np.array(real), np.array(sim), np.array(fuel))


def settled(fuel: FloatArray, dt_s: float) -> NDArray[np.bool_]:
    """Where fuel flow (engines, time) has not moved in the last seconds, nor is about to."""
    before, after = round(BEFORE_S / dt_s), round(AFTER_S / dt_s)
    size, origin = before + after + 1, (before - after) // 2
    reach = maximum_filter1d(fuel, size, axis=1, origin=origin)
    reach -= minimum_filter1d(fuel, size, axis=1, origin=origin)
    return np.asarray(reach < MOVED * np.ptp(fuel, axis=1, keepdims=True))


def search(judged: Judged, rows: Sequence[int]) -> Windows:
    """Windows that the engines `rows` share."""
    gap = judged.gap[list(rows)]
    known = np.isfinite(gap)
    weights = known / np.array([NOISE[name] for name in judged.outputs]) ** 2
    rising = judged.outputs.index("EGT_C") if "EGT_C" in judged.outputs else None
    options = Options(groups=(tuple(range(len(rows))),), rising=rising, draws=DRAWS, at_rest=False)
    steady = settled(judged.fuel[list(rows)], judged.dt_s)
    return find_windows(np.where(known, gap, 0.0), weights, judged.dt_s, options, steady)


def study(title: str, judged: Judged) -> FlightStudy:
    """Windows of both engines and of each, and the errors step by step."""
    if len(judged.engines) != 2:
        raise DataError(f"expected two engines in {title}, found {len(judged.engines)}")
    both = search(judged, (0, 1))
    alone = {name: search(judged, (e,)) for e, name in enumerate(judged.engines)}
    return FlightStudy(title, judged, both, alone, steps(judged, both, alone))


if __name__ == "__main__":
    sys.exit(main())
