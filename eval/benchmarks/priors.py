"""Priors by the recorders, with each left out in turn: `python -m eval.benchmarks.priors`.

`training.scatter.ScatterPrior` and `training.scatter.StepPrior` are the most likely by what logs of
each recorder show that are left out of its bank. `training.steady_fit.SPREADS` is the root mean
square of how far exponents of theta and delta are from similarity, as shares of the output's level:
those of the steady state of all logs of each recorder that flies, in corrected parameters, blended
over Mach; held by their prior, whose size that should be, and free of it, where much is the error
of estimates of two ratios of the air that vary together.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from scipy.optimize import minimize

from data_prep.equilibrium import quasi_steady
from data_prep.prepare import hold_inputs, prepare, with_outputs
from eval.benchmarks.recorders import SETS, Recorder
from narxcal.channels import channel, spools_of
from narxcal.steady.fitted import RATIOS, Layout
from narxcal.support.arrays import FloatArray
from training.masking import by_each_other
from training.redundancy import is_measured
from training.redundancy_fit import learn
from training.scatter import PRIORS, Priors, ScatterPrior, StepPrior
from training.steady_fit import SPREADS, SteadySamples, fit_steady_state

FLYING: Final = ("citation", "a321", "agtf30")


@dataclass(frozen=True, eq=False)
class Shown:
    """What logs of one recorder show that are left out of its bank: the evidence for priors."""

    levels: Mapping[str, Sequence[float]]
    delays: Mapping[str, Sequence[float]]
    steps: Mapping[str, Mapping[int, Sequence[float]]]

    @classmethod
    def by(cls, recorder: Recorder) -> Self:
        """Learn the bank of all logs of a recorder, without what they show to be at fault."""
        config = recorder.config
        names = (*config.narx.outputs, *config.steady_state.inputs)
        raw = [log for logs in recorder.recordings.values() for log in logs]
        logs = by_each_other([one.log for one in prepare(raw, config)], names)
        bank = learn([log.without_faults() for log in logs], names)
        if bank is None:
            return cls({}, {}, {})
        levels = {name: each for name, each in bank.level.items() if is_measured(name)}
        return cls(levels, bank.late, bank.heights)


def most_likely(shown: Sequence[Shown]) -> Priors:
    """Maximise the evidence of all recorders, over the logarithms of the priors' parameters."""

    def scatter(x: FloatArray) -> ScatterPrior:
        *medians, other, delay_s, recorders, channels = np.exp(x).tolist()
        units = dict(zip(PRIORS.scatter.median, medians, strict=True))
        return ScatterPrior(units, other, delay_s, recorders, channels)

    def steps(x: FloatArray) -> StepPrior:
        return StepPrior(*np.exp(x).tolist())

    one = PRIORS.scatter
    start = [*one.median.values(), one.other, one.delay_s, one.recorders, one.channels]
    return Priors(
        scatter(
            _maximum(
                lambda x: sum(scatter(x).log_evidence(each.levels, each.delays) for each in shown),
                start,
            )
        ),
        steps(
            _maximum(
                lambda x: sum(steps(x).log_evidence(each.steps) for each in shown),
                list(asdict(PRIORS.steps).values()),
            )
        ),
    )


def _maximum(evidence: Callable[[FloatArray], float], start: Sequence[float]) -> FloatArray:
    begin: FloatArray = np.log(np.array(start))

    def loss(x: FloatArray) -> float:
        return -evidence(x)

    found = minimize(
        loss, begin, method="Nelder-Mead",
        options={"maxiter": 4000, "maxfev": 4000, "xatol": 1e-2, "fatol": 1e-3},
    )  # fmt: skip
    return np.asarray(found.x)


def without_each(data: Path) -> dict[str, Priors]:
    """The most likely priors by all recorders (""), and by all others than each of them.

    Raises `DataError` where one is missing.
    """
    shown = {name: Shown.by(Recorder.read(name, data)) for name in SETS}
    return {
        name: most_likely([each for other, each in shown.items() if other != name])
        for name in ("", *shown)
    }


def exponents(
    recorder: Recorder, spreads: Mapping[str, tuple[float, float]]
) -> dict[str, FloatArray]:
    """Unit -> exponents less those of similarity (outputs, 2) of theta and delta."""
    config = recorder.config
    names, outputs = config.steady_state.inputs, config.narx.outputs
    blend = tuple(name for name in ("Mach",) if name in names)
    layout = Layout(
        input_names=names, output_names=outputs, driver=config.driver, blend=blend,
        exponents=RATIOS,
    )  # fmt: skip
    samples = []
    for one in prepare([log for logs in recorder.recordings.values() for log in logs], config):
        log = with_outputs(hold_inputs(one.log, names), outputs)
        rows = quasi_steady(log, config.driver, spools_of(outputs), config.quasi_steady)
        rows &= np.isfinite(log.matrix(names)).all(axis=1)
        u, y = log.matrix(names)[rows], log.matrix(outputs)[rows]
        samples.append(SteadySamples(u, y, log.source.engine, log.name))
    model, _ = fit_steady_state(samples, layout, spreads=spreads)
    level = np.nanmedian(
        np.concatenate([layout.to_corrected(one.inputs, one.outputs) for one in samples]), axis=0
    )
    share = (model.air_lines[:, :, 0] / level).T
    units = [channel(name).unit for name in outputs]
    return {unit: share[[k for k, own in enumerate(units) if own == unit]] for unit in set(units)}


def table(found: Mapping[str, Mapping[str, FloatArray]]) -> str:
    """Exponents by recorder, and the root mean squares without each."""
    lines = []
    for unit in SPREADS:
        own = {name: one[unit] for name, one in found.items() if unit in one}
        for name, values in own.items():
            pairs = ", ".join(f"{theta:+.3f} {delta:+.3f}" for theta, delta in values)
            lines.append(f"{unit}, {name}: theta and delta {pairs}")
        for name in ("none", *own):
            rest = np.concatenate([values for other, values in own.items() if other != name])
            theta, delta = np.sqrt(np.mean(rest**2, axis=0))
            lines.append(f"{unit}, without {name}: RMS {theta:.3f} {delta:.3f}")
    return "\n".join(lines)


def _values(prior: Mapping[str, Any]) -> str:
    """Parameters of a prior in words, those by unit one by one."""
    flat = {
        key: value for name, each in prior.items()
        for key, value in (each.items() if isinstance(each, dict) else [(name, each)])
    }  # fmt: skip
    return ", ".join(f"{key} {value:.3g}" for key, value in flat.items())


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    data = Path(__file__).resolve().parents[3] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=data)
    folder = parser.parse_args().data.resolve()
    for name, priors in without_each(folder).items():
        for prior in (priors.scatter, priors.steps):
            title = f"{type(prior).__name__}, without {name or 'none'}"
            sys.stdout.write(f"{title}: {_values(asdict(prior))}\n")
    flying = {name: Recorder.read(name, folder) for name in FLYING}
    for words, spreads in {"held": SPREADS, "free": dict.fromkeys(SPREADS, (1.0, 1.0))}.items():
        found = {name: exponents(one, spreads) for name, one in flying.items()}
        sys.stdout.write(f"{words}\n{table(found)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
