"""Flies the paper's data sets and the records of what it left open, and tabulates the engine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from eval.reproduce.data_sets import as_config
from eval.virtual_flights import WriteOptions, load_scenario, write_flights
from narxcal.errors import ConfigError
from narxcal.flight_test.scenario import FlightScenario
from narxcal.steady_export.grid import Grid
from narxcal.steady_export.report import ExportOptions, ExportReport
from narxcal.steady_export.table import export_table
from narxcal.steady_source import open_steady
from training.config import RunConfig

SCENARIO = "narx_paper"
TABLE = "maker.csv"
# Of the further records, one engine of a few flights is enough: all are twenty hours of flight.
FURTHER: Mapping[str, Mapping[str, object]] = {
    "throttle_rate": {"records": "throttle_rate", "engines": ("left",), "flights": 4},
    "take_off_approach": {"records": "take_off_approach", "engines": ("left",)},
}
_ROWS = 24_000
_START = {
    "TRA_deg": (0.0, 20.0, 40.0, 60.0, 85.0),
    "ALT_ft": (-1000.0, 0.0, 10_000.0, 20_000.0, 30_000.0, 36_089.0, 40_000.0),
    "Mach": (0.0, 0.3, 0.6, 0.85),
    "dT_C": (-30.0, -5.0, 20.0),
    "WOW": (0.0, 1.0),
    "Approach": (0.0, 1.0),
    "ECS": (1.0,),
    "NAI": (0.0,),
    "WAI": (0.0,),
}


def paper_scenario(seed: int) -> FlightScenario:
    """The shipped scenario at another seed, with an engine that is just as its maker says.

    The scatter between engines of one type is a static error of the maker's model. The paper's
    model was of the very engines flown; what the scatter does is for `evaluate --trim`.
    """
    outputs = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
    changed = {"seed": seed, "build_scatter_pct": 0.0, "outputs": outputs}
    return load_scenario(SCENARIO).model_copy(update=changed)


def write_records(folder: Path, scenario: FlightScenario, jobs: int = 1) -> None:
    """Write the scenario's logs with their truth, and each further family in a folder below.

    The same scenario, the same bytes.
    """
    write_flights(folder, scenario, WriteOptions(jobs, true_channels=True))
    for name, changed in FURTHER.items():
        table = {**scenario.model_dump(by_alias=True, exclude_unset=True), **changed}
        write_flights(folder / name, FlightScenario.parse(table, name), WriteOptions(jobs))


def flown(config: RunConfig, base: Path, folder: Path) -> tuple[RunConfig, ExportReport]:
    """The configuration with the logs of `folder` and the steady-state model as a table there.

    Solving the gas path for every sample of every log would take longer than all the studies;
    the report says how far the table is off. Raises `ConfigError` for an input that the flights
    do not have, and as `open_steady`.
    """
    section, outputs = config.steady_state, config.narx.outputs
    model = open_steady(
        section.kind, section.source, (section.inputs, outputs), base, section.options
    )
    grid = Grid({name: _nodes(name) for name in section.inputs})
    options = ExportOptions(max_rows=_ROWS, tolerance_pct=0.1, source=section.source)
    report = export_table(model, grid, folder / TABLE, options)
    return with_table(as_config(config, folder), folder), report


def with_table(config: RunConfig, folder: Path) -> RunConfig:
    """The configuration with the steady-state model that `flown` wrote into `folder`."""
    varying = tuple(name for name in config.steady_state.inputs if len(_nodes(name)) > 1)
    source = str((folder / TABLE).resolve())
    table = {"kind": "table", "source": source, "inputs": varying}
    section = config.steady_state.model_copy(update=table)
    return config.model_copy(update={"steady_state": section})


def _nodes(name: str) -> tuple[float, ...]:
    if name not in _START:
        raise ConfigError(
            "[steady_state] inputs names what the virtual flights do not have",
            channel=name,
            hint=f"They have {', '.join(_START)}; or bring logs by --data",
        )
    return _START[name]
