"""How far exponents of theta and delta lie from similarity: `python -m eval.benchmarks.exponents`.

The steady state of all logs of each recorder that flies is fitted in corrected parameters, blended
over Mach. The table gives the exponents as shares of the output's level, by unit, and their root
mean square over the recorders, with each of them left out in turn: held by the prior
`training.steady_fit.SPREADS`, whose size that should be, and free of it, where much is the error of
estimates of two ratios of the air that vary together.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from data_prep.equilibrium import quasi_steady
from data_prep.prepare import hold_inputs, prepare, with_outputs
from eval.benchmarks.recorders import Recorder
from narxcal.channels import channel, spools_of
from narxcal.steady.fitted import RATIOS, Layout
from narxcal.support.arrays import FloatArray
from training.steady_fit import SPREADS, SteadySamples, fit_steady_state

FLYING: Final = ("citation", "a321", "agtf30")


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


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    data = Path(__file__).resolve().parents[3] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=data)
    folder = parser.parse_args().data.resolve()
    read = {name: Recorder.read(name, folder) for name in FLYING}
    for words, spreads in {"held": SPREADS, "free": dict.fromkeys(SPREADS, (1.0, 1.0))}.items():
        found = {name: exponents(one, spreads) for name, one in read.items()}
        sys.stdout.write(f"{words}\n{table(found)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
