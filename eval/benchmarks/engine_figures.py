"""Pictures of the virtual engine: its compressor maps with running lines, and slams."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from eval.benchmarks import engine_manoeuvres
from narxcal.atmosphere import air_state
from narxcal.turbofan import VirtualEngine
from narxcal.turbofan.design import close
from narxcal.turbofan.maps import SURGE, CompressorMap, compressor
from narxcal.turbofan.presets import PRESETS
from narxcal.turbofan.stations import GasPath
from narxcal.turbofan.virtual_engine import COMPRESSORS

FloatArray = NDArray[np.float64]
_SPEEDS = np.arange(0.3, 1.11, 0.1)
_LINES = (("sea level static", 0.0, 0.0), ("35 kft, Mach 0.78", 35000.0, 0.78))
_OUTPUTS = (("N1_pct", "N1, %"), ("N2_pct", "N2, %"), ("EGT_C", "EGT, degC"), ("FN_kN", "FN, kN"))


def draw(folder: Path) -> None:
    """Write `virtual_engine_maps.png` and `virtual_engine_slams.png` into `folder`."""
    for name, figure in (("maps", maps()), ("slams", slams())):
        figure.savefig(folder / f"virtual_engine_{name}.png", dpi=80, metadata={"Software": None})


def maps() -> Figure:
    """All compressor maps, an engine a row, with two settled running lines."""
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    grid = figure.subplots(len(PRESETS), len(COMPRESSORS))
    for row, name in zip(grid, PRESETS, strict=True):
        path = close(PRESETS[name].point, PRESETS[name].shape).path
        for axes, part in zip(row, COMPRESSORS, strict=True):
            _map(axes, getattr(path, part))
            for line in _LINES:
                axes.plot(
                    *_running_line(VirtualEngine(name), path, part, line), lw=1.6, label=line[0]
                )
            axes.set_title(f"{name}: {part.upper()}")
        row[0].set_ylabel("pressure ratio")
    for axes in grid[-1]:
        axes.set_xlabel("corrected flow, kg/s")
    grid[0][0].legend(loc="upper left", fontsize=8)
    return figure


def _map(axes: Axes, chart: CompressorMap) -> None:
    """Speed lines from choke to surge, the backbone, and the surge line."""
    angles = np.linspace(0.0, SURGE, 60)
    for speed in _SPEEDS:
        flow, ratio = np.array([compressor(chart, speed, a)[:2] for a in angles]).T
        axes.plot(flow, ratio, color="0.7", lw=0.8)
        axes.annotate(f"{speed:.1f}", (flow[0], ratio[0]), fontsize=6, color="0.5")
    for angle, style, label in ((0.5 * SURGE, ":", "backbone"), (SURGE, "-", "surge")):
        ends = np.array([compressor(chart, speed, angle)[:2] for speed in _SPEEDS]).T
        axes.plot(*ends, style, color="k", lw=1.0, label=label)


def _running_line(
    engine: VirtualEngine, path: GasPath, part: str, line: tuple[str, float, float]
) -> FloatArray:
    """Corrected flow and pressure ratio from idle to take-off, (2, 60)."""
    u = np.zeros((60, 9))
    u[:, 0], u[:, 1], u[:, 2] = np.linspace(0.0, 85.0, len(u)), *line[1:]
    u[:, 4] = float(line[1] == 0.0)
    solved = engine.gas_path(u)
    speed = solved["n1"] / air_state(*line[1:]).theta2 ** 0.5
    if part == "hpc":
        speed = solved["n2"] * (path.hpc_reference_K / solved["T21"]) ** 0.5
    chart, angle = getattr(path, part), solved[f"{part}_angle"]
    return np.array([compressor(chart, n, a)[:2] for n, a in zip(speed, angle, strict=True)]).T


def slams() -> Figure:
    """N1, N2, EGT and thrust of a slam and a chop, low and high."""
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    grid = figure.subplots(len(PRESETS), len(_OUTPUTS), sharex=True)
    t = np.arange(40 * engine_manoeuvres.HZ) / engine_manoeuvres.HZ
    angle = np.where((t >= 2.0) & (t < 20.0), 85.0, 0.0)
    for row, name in zip(grid, PRESETS, strict=True):
        engine = VirtualEngine(name)
        for condition in engine_manoeuvres.CONDITIONS:
            inputs = engine_manoeuvres.log(angle, condition)
            run = engine.simulate(inputs, 1.0 / engine_manoeuvres.HZ)
            for axes, (channel, label) in zip(row, _OUTPUTS, strict=True):
                axes.plot(t, run[channel], lw=1.2, label=condition)
                axes.set_ylabel(label)
        row[0].set_title(name)
    for axes in grid[-1]:
        axes.set_xlabel("time, s")
    grid[0][0].legend(fontsize=8)
    return figure
