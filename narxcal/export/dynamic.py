"""A run to be exported: its model with a steady state that C can hold, and what to say of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.export.grid import Grid
from narxcal.export.parts import is_exact
from narxcal.export.plan import plan
from narxcal.export.program import Program
from narxcal.export.report import ExportOptions, ExportReport, generation_tool
from narxcal.intervals import LEVEL
from narxcal.support.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Exportable:
    """A run's model as its exports compute it.

    `model` has a sampled steady state where that of `original` is neither a gridded table nor
    fitted; `sampled` is then the report of its errors.
    """

    original: Calibration
    model: Calibration
    sampled: ExportReport | None
    sha256: str
    name: str

    @classmethod
    def of(
        cls,
        bundle: Bundle,
        engine: str | None = None,
        nodes: Mapping[str, Sequence[float]] | None = None,
        options: ExportOptions | None = None,
    ) -> Exportable:
        """Choose an engine, and sample the steady state where it has to be.

        Raises `ConfigError` for an engine that the run does not know, else as `plan`.
        """
        model, chosen = bundle.calibration, options or ExportOptions()
        if engine is not None:
            known = tuple(getattr(model.steady, "engines", ()))
            if engine not in known:
                raise ConfigError(
                    f"the run has no model of an engine '{engine}'",
                    hint=f"Engines are {', '.join(known)}" if known else "Leave --engine out",
                )
            model = model.for_engine(engine)
        if is_exact(model.steady):
            return cls(model, model, None, bundle.sha256, chosen.source)
        grid = Grid.of_model(model.steady, nodes)
        planned = plan(model.steady, grid, chosen, separate=True)
        sampled = model.with_steady(planned.gridded.over(model.input_names))
        report = planned.report(grid, chosen, "", 0)
        return cls(model, sampled, report, bundle.sha256, chosen.source)

    def program(self, level: float = LEVEL) -> Program:
        """The model as C."""
        return Program(self.model, self.about, self.sha256, level)

    @property
    def about(self) -> list[str]:
        """Lines on what the file is."""
        lines = [
            f"Turbofan model '{self.name}' by {generation_tool()}: {self.original.words}",
            f"Run {self.sha256 or 'without a hash'}, sampled every {self.model.dt_s:.9g} s",
        ]
        if self.sampled is not None:
            lines += [
                f"Its steady state was sampled, largest error at {self.sampled.measured.inside} "
                "random conditions: "
                + ", ".join(f"{o.name} {o.max:.3g} {o.unit}" for o in self.sampled.measured.outputs)
            ]
        return lines
