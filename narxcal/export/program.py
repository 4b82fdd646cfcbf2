"""A stored model as one C file and one header: the runtime's files, and its numbers as tables.

`Exportable` is a run with a steady state that C can hold, and what to say of it.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any

import numpy as np

from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import described
from narxcal.export.grid import Grid
from narxcal.export.parts import Part, Struct, is_exact, parts_of, steady_struct
from narxcal.export.plan import plan
from narxcal.export.report import ExportOptions, ExportReport, generation_tool
from narxcal.intervals import LEVEL, LEVELS
from narxcal.steady.model import Envelope
from narxcal.support.errors import ConfigError

_PER_LINE = 6
# The runtime's files in the order of their use.
_ORDER = (
    "delay", "air", "grid", "table", "fitted", "lags", "limited", "governed", "narx", "member",
    "lag_step", "response", "state_space", "output_error",
)  # fmt: skip


def shipped(name: str) -> str:
    return files("narxcal.export").joinpath("c", name).read_text(encoding="utf-8")


@dataclass(frozen=True, eq=False)
class Program:
    """A calibration to be written as C.

    `about` are lines on where it comes from, `sha256` is the hash of the run, `level` the share of
    samples that intervals cover.
    """

    model: Calibration
    about: Sequence[str] = ()
    sha256: str = ""
    level: float = LEVEL

    @cached_property
    def _steady(self) -> tuple[Struct, tuple[str, ...]]:
        return steady_struct(self.model.steady)

    @property
    def steady_struct(self) -> Struct:
        return self._steady[0]

    @cached_property
    def parts(self) -> list[Part]:
        """Parts of the dynamics; empty for a steady state alone."""
        return parts_of(self.model)

    @property
    def engines(self) -> tuple[str, ...]:
        """Names of engines by number; the first is the one chosen, "" for none in particular."""
        return self._steady[1]

    def number_of(self, engine: str) -> int:
        """Number of an engine; 0, the chosen one, for a name that the model does not know."""
        return self.engines.index(engine) if engine in self.engines else 0

    @property
    def states(self) -> int:
        """Numbers in the state: of the parts, then of the transport delay."""
        rows, _, columns = self.delay
        return sum(part.states for part in self.parts) + rows * len(columns)

    @property
    def delay(self) -> tuple[int, float, list[int]]:
        """Samples that a transport delay stores, its part of a sample, and the late columns."""
        delay, model = self.model.delay, self.model
        if delay is None:
            return 0, 0.0, []
        whole = int(delay.delay_s / model.dt_s)
        columns = [model.input_names.index(name) for name in delay.channels]
        return whole + 1, delay.delay_s / model.dt_s - whole, columns

    @property
    def start(self) -> list[float]:
        """Inputs before any are known: zero, or the nearest value in the envelope."""
        zero: list[float] = self.envelope.clamp(np.zeros(len(self.model.input_names))).tolist()
        return zero

    @property
    def envelope(self) -> Envelope:
        numbers = self._steady[0].numbers
        return Envelope(numbers["low"], numbers["high"])

    @cached_property
    def code(self) -> dict[str, str]:
        return {"engine.h": self._header(), "engine.c": self._source()}

    def _header(self) -> str:
        inputs, outputs = self.model.input_names, self.model.output_names
        low, high = self.envelope.low.tolist(), self.envelope.high.tolist()
        bounds = [
            f"#define NARXCAL_{end}_{name} ({_number(value)})"
            for end, values in (("LOW", low), ("HIGH", high))
            for name, value in zip(inputs, values, strict=True)
        ]
        enums = [
            "enum { /* inputs */",
            *(f"    NARXCAL_{name}, /* {_meaning(name)} */" for name in inputs),
            "    NARXCAL_INPUTS\n};",
            "enum { /* outputs */",
            *(f"    NARXCAL_OUT_{name}, /* {_meaning(name)} */" for name in outputs),
            "    NARXCAL_OUTPUTS\n};",
            "enum { /* engines */",
            *(
                f"    NARXCAL_ENGINE_{re.sub(r'[^A-Za-z0-9]', '_', name) or 'chosen'},"
                # Without the name that the chosen one has among the others.
                for name in (self.engines[0] if len(self.engines) == 1 else "", *self.engines[1:])
            ),
            "    NARXCAL_ENGINES\n};",
        ]
        text = shipped("engine.h")
        return (
            text.replace("@ABOUT@", _comment(self.about))
            .replace("@SHA256@", self.sha256)
            .replace("@DT_S@", _number(self.model.dt_s))
            .replace("@STATES@", str(max(self.states, 1)))
            .replace("@MEMORY@", str(int(self.states > 0)))
            .replace("@LEVEL@", _number(self.level))
            .replace("@NAMES@", "\n".join(enums))
            .replace("@BOUNDS@", "\n".join(bounds))
        )

    def _source(self) -> str:
        steady, structs = self._steady[0], [part.struct for part in self.parts]
        needs = {name for struct in (steady, *structs) for name in struct.needs}
        define = {k: v for struct in (steady, *structs) for k, v in struct.define.items()}
        head = ["#include <math.h>", "#include <stddef.h>", "", '#include "engine.h"', ""]
        if self.delay[0]:
            define["delay"], needs = self._delay(), {*needs, "delay"}
        runtime = [shipped(f"{name}.c") for name in ("base", *_ORDER) if name in {"base", *needs}]
        return "\n".join(
            [
                _comment(["Generated by narxcal, see engine.h: its runtime, then its numbers."]),
                *head,
                *define.values(),
                *runtime,
                "/* ---- the numbers of this model */\n",
                *_struct("steady_numbers", steady),
                _steady_function(steady.kind),
                *self._parts(),
                *self._limits(),
                shipped("model.c"),
            ]
        )

    def _delay(self) -> str:
        rows, part, columns = self.delay
        at = sum(one.states for one in self.parts)
        sizes = {"ROWS": rows, "COLUMNS": len(columns), "AT": at, "PART": _number(part)}
        lines = [f"#define DELAY_{name} {value}" for name, value in sizes.items()]
        return "\n".join([*lines, _array("delay_column", np.array(columns))])

    def _parts(self) -> Iterator[str]:
        rows, at = [], 0
        for number, part in enumerate(self.parts):
            kind = part.struct.kind
            yield from _struct(f"{kind}_{number}", part.struct)
            yield _array(f"weights_{number}", part.weights)
            named = f"&{kind}_{number}, weights_{number}"
            rows.append(f"    {{{kind}_start, {kind}_step, {named}, {at}}}")
            at += part.states
        body = ",\n".join(rows or ["    {NULL, NULL, NULL, NULL, 0}"])
        yield f"static const part parts[] = {{\n{body}\n}};"

    def _limits(self) -> Iterator[str]:
        """Limits of inputs and measured outputs, where inputs start, tables of the interval."""
        model, count = self.model, len(self.model.input_names)
        reach = model.reach or Envelope(np.full(count, -np.inf), np.full(count, np.inf))
        yield _array("reach_low", reach.low)
        yield _array("reach_high", reach.high)
        yield _array("start_inputs", np.array(self.start))
        measured = np.transpose([described(name).limits for name in model.output_names])
        yield _array("measured_low", measured[0])
        yield _array("measured_high", measured[1])
        none = [np.empty(0)] * len(model.output_names)
        knots, widths = none, none
        if model.interval is not None:
            knots = list(model.interval.knots)
            widths = [
                np.array([np.interp(self.level, LEVELS, each) for each in one.T])
                for one in model.interval.widths
            ]
        counts = [len(one) for one in knots]
        yield _array("width_count", np.array(counts))
        yield _array("width_first", np.cumsum([0, *counts[:-1]]))
        yield _array("widths_at", np.array([*np.concatenate(knots), 0.0]))
        yield _array("widths", np.array([*np.concatenate(widths), 0.0]))


def _steady_function(kind: str) -> str:
    engine = ("engine, ", "") if kind == "fitted" else ("", "    (void)engine;\n")
    return (
        f"static int steady(int engine, const double *in, double *ss)\n{{\n{engine[1]}"
        f"    return {kind}_outputs(&steady_numbers, {engine[0]}in, ss);\n}}\n"
    )


def _meaning(name: str) -> str:
    known = described(name)
    return f"{known.meaning} [{known.unit}]"


def _comment(lines: Sequence[str]) -> str:
    plain = ["".join(c for c in line if c.isprintable()).replace("*/", "* /") for line in lines]
    wrapped = [part for line in plain for part in textwrap.wrap(line, 92)]
    return "/* " + "\n * ".join(wrapped) + " */"


def _struct(name: str, struct: Struct) -> Iterator[str]:
    """Arrays of a structure, then the structure itself."""
    fields = []
    for key, value in struct.numbers.items():
        if isinstance(value, Struct):
            yield from _struct(f"{name}_{key}", value)
            fields.append(f".{key} = &{name}_{key}")
        elif isinstance(value, list):
            initial = []
            for number, one in enumerate(value):
                yield from _arrays(f"{name}_{key}_{number}", one.numbers)
                initial.append(_initial(f"{name}_{key}_{number}", one.numbers))
            body = ",\n    ".join(initial)
            yield f"static const {value[0].kind} {name}_{key}[] = {{\n    {body}\n}};"
            fields.append(f".{key} = {name}_{key}")
        else:
            yield from _arrays(f"{name}_{key}", {"": value})
            fields.append(f".{key} = {_reference(f'{name}_{key}', value)}")
    joined = textwrap.fill(", ".join(fields), 92, break_long_words=False)
    yield f"static const {struct.kind} {name} = {{\n{textwrap.indent(joined, '    ')}\n}};\n"


def _arrays(name: str, numbers: Any) -> Iterator[str]:
    for key, value in numbers.items():
        if isinstance(value, np.ndarray) and value.size:
            yield _array(f"{name}_{key}".rstrip("_"), value)


def _initial(name: str, numbers: Any) -> str:
    shown = (f".{key} = {_reference(f'{name}_{key}', value)}" for key, value in numbers.items())
    return "{" + ", ".join(shown) + "}"


def _reference(name: str, value: Any) -> str:
    if isinstance(value, np.ndarray):
        return name if value.size else "NULL"
    return value if isinstance(value, str) else _number(value)


def _array(name: str, values: Any) -> str:
    """Format as a C array; `repr` is the shortest text that is read back exactly."""
    kinds = {"b": "unsigned char", "i": "int", "f": "double"}
    texts = [_number(value) for value in values.ravel().tolist()]
    lines = [", ".join(texts[k : k + _PER_LINE]) for k in range(0, len(texts), _PER_LINE)]
    body = ",\n    ".join(lines)
    return f"static const {kinds[values.dtype.kind]} {name}[] = {{\n    {body}\n}};"


def _number(value: float) -> str:
    if isinstance(value, int):
        return str(int(value))
    if math.isfinite(value):
        return repr(value)
    return "NAN" if math.isnan(value) else ("-" if value < 0.0 else "") + "INFINITY"


# --- a run ---


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
        """Choose an engine, and sample the steady state where it has to be."""
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
        return Program(self.model, self.about, self.sha256, level)

    @property
    def about(self) -> list[str]:
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
