"""Options of an export, the errors measured at random conditions, and the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from narxcal.channels import described
from narxcal.export.grid import Grid
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import versions
from narxcal.support.progress import Progress, silent

Stopped = Literal["tolerance", "size", "nodes"]
ADVICE = "Allow a larger tolerance or more rows, give nodes where the model bends, or fix an input"
_WHY = {
    "tolerance": "the tolerance is met",
    "size": "the limit of rows was reached",
    "nodes": "finer nodes are not tried",
}


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Accuracy and size of an export, and whether a missed tolerance is an error.

    `tolerance_pct` bounds the largest error of each output in percent of its range; nodes are
    added (unless `refine` is off) until it is met or the next one would make more than `max_rows`
    rows. The error is measured at `probes` random conditions drawn from `seed`. `source` is the
    origin of the model that the file names.
    """

    tolerance_pct: float = 0.5
    max_rows: int = 100_000
    refine: bool = True
    strict: bool = False
    probes: int = 4096
    seed: int = 0
    source: str = ""
    progress: Progress = silent

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance_pct < 100.0:
            raise ConfigError(
                f"expected a tolerance above 0 and below 100 %, got {self.tolerance_pct:g}"
            )
        for name in ("max_rows", "probes"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} has to be 1 or more, got {getattr(self, name)}")


@dataclass(frozen=True)
class OutputError:
    """Error of one output over the random conditions, in the output's unit.

    `range` is that of the output over the same conditions.
    """

    name: str
    unit: str
    range: float
    max: float
    rms: float

    @property
    def max_pct(self) -> float:
        return 100.0 * self.max / self.range


@dataclass(frozen=True)
class Measured:
    """Errors at the `inside` random conditions of `probes` that are in the envelope."""

    outputs: tuple[OutputError, ...]
    probes: int
    inside: int

    @property
    def worst_pct(self) -> float:
        return max(output.max_pct for output in self.outputs)


@dataclass(frozen=True)
class ExportReport:
    """The exported file: nodes, rows, errors, and why no more nodes were added.

    `additive` are the switches whose effects are stored on grids of their own (FMU only).
    """

    file: str
    bytes: int
    rows: int
    axes: Mapping[str, tuple[float, ...]]
    fixed: Mapping[str, float]
    additive: tuple[str, ...]
    measured: Measured
    tolerance_pct: float
    stopped: Stopped

    @property
    def met(self) -> bool:
        return self.measured.worst_pct <= self.tolerance_pct

    @property
    def shortfall(self) -> str:
        return (
            f"the largest error, {self.measured.worst_pct:.3g} % of the range, is above the "
            f"tolerance of {self.tolerance_pct:g} %: {self.why}. {ADVICE}"
        )

    @property
    def why(self) -> str:
        return _WHY[self.stopped]

    def to_dict(self) -> dict[str, Any]:
        document = asdict(self) | {"axes": dict(self.axes), "fixed": dict(self.fixed)}
        measured = document.pop("measured")
        for row, output in zip(measured["outputs"], self.measured.outputs, strict=True):
            row["max_pct"] = output.max_pct
        return {**document, **measured, "met": self.met, "why": self.why}


class Probes:
    """Random conditions, and the model's outputs there, to measure the error of an export."""

    def __init__(self, model: SteadyStateModel, grid: Grid, options: ExportOptions) -> None:
        drawn = grid.draw(options.probes, np.random.default_rng(options.seed))
        self.names, self.drawn = model.output_names, len(drawn)
        self.inputs = drawn[model.inside(drawn)]
        if not len(self.inputs):
            raise ModelError(
                "the model is valid nowhere between these nodes",
                hint="Give nodes inside its envelope",
            )
        self.truth = np.asarray(model.outputs(self.inputs), dtype=np.float64)
        self.scale: FloatArray = np.ptp(self.truth, axis=0)
        # The error of a constant output is relative to its size.
        size = np.maximum(np.abs(self.truth).max(axis=0), 1e-6)
        self.scale = np.where(self.scale > 1e-9 * size, self.scale, size)

    def measure(self, found: FloatArray) -> Measured:
        """Compare `found` (n, n_out) with the model."""
        difference = np.abs(found - self.truth)
        largest, rms = difference.max(axis=0), np.sqrt(np.mean(difference**2, axis=0))
        rows = zip(self.names, self.scale, largest, rms, strict=True)
        outputs = tuple(
            OutputError(name, described(name).unit, float(scale), float(worst), float(mean))
            for name, scale, worst, mean in rows
        )
        return Measured(outputs, self.drawn, len(self.inputs))


def generation_tool() -> str:
    """Name and version of narxcal, as exported files have it."""
    return f"narxcal {versions()['narxcal']}"


def description(report: ExportReport, source: str) -> list[str]:
    """Lines about an export: source, tool, errors and fixed inputs."""
    fixed = ", ".join(f"{name} = {value:g}" for name, value in report.fixed.items())
    model = " ".join(["Steady-state engine model", *"".join(filter(_plain, source)).split()])
    return [
        f"{model}, sampled by {generation_tool()}",
        f"Largest interpolation errors at {report.measured.inside} random conditions",
        *(
            f"{output.name} {output.max:.3g} {output.unit} ({output.max_pct:.2g} % of its range), "
            f"RMS {output.rms:.2g}"
            for output in report.measured.outputs
        ),
        *([f"Holds for {fixed} only"] if fixed else []),
    ]


def _plain(letter: str) -> bool:
    """Whether a letter is allowed in a comment and in XML."""
    return letter.isprintable() or letter.isspace()
