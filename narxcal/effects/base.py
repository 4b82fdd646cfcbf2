"""What an effect is: a small, bounded departure of the real engine from its simulator.

An effect has named parameters and acts on the *input* (what reaches the engine), on *where it
settles*, on the *rate* (how fast it moves) or on the *output* (what the sensor reports). Any
simulator that accepts other inputs, settled values and paces takes any effect without a change of
its own (see `effects.running`).

Effects on rates set the engine to another `Pace`. A two-spool engine moves by the power its core
has to spare. What can be different is how fast either spool turns that into speed, up or down; what
thin air makes of it; how much acceleration the control allows; how late the fuel valve follows what
the control asks for; and what metal that is colder than the gas, or warmer, takes of the power or
gives to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final, Literal, NamedTuple

import numpy as np

from narxcal.atmosphere import air_at
from narxcal.channels import described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError

UNLIMITED: Final = 1e6  # %/s: no limit at all


class Pace(NamedTuple):
    """How fast an engine moves against its simulator; each field is `(batch,)`.

    Rates of the fan and of the core are so many times as fast while they speed up and while they
    slow down, and go with `thin_air` as a further power of `delta / sqrt(theta)`. `limit` is the
    greatest acceleration that the control asks for over the simulator's own, `fall` the greatest
    deceleration; `valve_s` is a further lag between what it asks for and the fuel. What fuel does
    to the core depends on the core's own time constant `core_s` at constant fuel, which no log of a
    governed engine shows. The core lacks `loss` (%/s) per unit of a temperature by which the
    metal, behind a lag of `metal_s`, trails the blades, behind one of `rise_s`. `most` is the
    greatest acceleration (%/s) that the control asks for at any speed and altitude.
    """

    fan_up: FloatArray
    fan_down: FloatArray
    core_up: FloatArray
    core_down: FloatArray
    thin_air: FloatArray
    limit: FloatArray
    valve_s: FloatArray
    core_s: FloatArray
    fall: FloatArray
    loss: FloatArray
    metal_s: FloatArray
    rise_s: FloatArray
    most: FloatArray


def as_simulated(batch: int) -> Pace:
    one, none = np.ones(batch), np.zeros(batch)
    return Pace(one, one, one, one, none, one, none, one, one, none, one, one, UNLIMITED * one)


def together(paces: Sequence[Pace]) -> Pace:
    """Several at once: factors multiply, powers, lags and losses add up.

    One alone has a `core_s`, and one alone has metal.
    """
    found = paces[0]
    for other in paces[1:]:
        products = [a * b for a, b in zip(found, other, strict=True)]
        found = Pace(*products)._replace(
            thin_air=found.thin_air + other.thin_air,
            valve_s=found.valve_s + other.valve_s,
            loss=found.loss + other.loss,
            most=np.minimum(found.most, other.most),
        )
    return found


Side = Literal["input", "process", "sensor"]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect. At `neutral` the effect is not there.

    `starts` are where a fit begins. The response is proportional to a `linear` parameter, which
    then needs no search; its `neutral` is 0.
    """

    name: str
    unit: str
    low: float
    high: float
    neutral: float
    starts: tuple[float, ...] = ()
    linear: bool = False

    @property
    def all_or_nothing(self) -> bool:
        """Whether it says which of two mechanisms it is, by its low or its high end."""
        return self.starts == (self.low, self.high)


@dataclass(frozen=True)
class Signals:
    """What a run is made of: names of the columns, the raster, and what `driver` moves.

    `low` and `high` are the range of each output in the simulator's logs, `(outputs,)`: what idle
    and full power mean. `lever` is that of the driver. `active` are the inputs that change.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt_s: float
    driver: str
    low: FloatArray
    high: FloatArray
    lever: tuple[float, float] = (0.0, 1.0)
    active: tuple[str, ...] = ()

    @property
    def governed(self) -> bool:
        """Whether a control holds the first output at what the lever asks for."""
        return self.driver == "TRA_deg"

    @property
    def free(self) -> tuple[str, ...]:
        """Outputs that nothing holds: all, or all but the governed first one."""
        return self.outputs[1:] if self.governed else self.outputs

    def u(self, name: str) -> int:
        """Column of an input; raises `ConfigError` where there is none."""
        return _column(self.inputs, name, "input")

    def y(self, name: str) -> int:
        """Column of an output; raises `ConfigError` where there is none."""
        return _column(self.outputs, name, "output")

    def width(self, output: str) -> float:
        column = self.y(output)
        return float(self.high[column] - self.low[column])

    @property
    def hot(self) -> int:
        """Column of the temperature that metal follows; of the last output where there is none."""
        last = len(self.outputs) - 1
        return self.outputs.index("EGT_C") if "EGT_C" in self.outputs else last

    def power(self, y: FloatArray) -> FloatArray:
        """Share of the range of the first output, 0 at idle and 1 at full power: `(...,)`."""
        return np.asarray((y[..., 0] - self.low[0]) / (self.high[0] - self.low[0]))

    def thin_air(self, u: FloatArray) -> FloatArray:
        """`delta / sqrt(theta)` of the air at the intake, `(...,)`; 1 without an altitude.

        Forces and flows of an engine at given corrected speed go with delta, its speeds with
        sqrt(theta): rates of its spools go with their quotient (NACA TR-1011).
        """
        if "ALT_ft" not in self.inputs:
            return np.ones(u.shape[:-1])
        air = air_at(u, self.inputs)
        return np.asarray(air.delta2 / np.sqrt(air.theta2))


def _column(names: Sequence[str], name: str, what: str) -> int:
    if name not in names:
        raise ConfigError(f"there is no {what} '{name}'", hint=f"There are {', '.join(names)}")
    return list(names).index(name)


@dataclass(eq=False)
class Run:
    """A batch of whole runs with one effect, on `channel` where it acts on one alone.

    `theta` (batch, parameters) is in the order of the effect's parameters, `u` (batch, time,
    inputs) are the inputs that reach the engine.
    """

    signals: Signals
    theta: FloatArray
    u: FloatArray
    channel: str | None = None


Hook = Callable[[Run, FloatArray], FloatArray]
Terms = tuple[tuple[str, str], ...]


def within_range(signals: Signals, shape: str, output: str) -> Parameter:
    width = signals.width(output)
    return Parameter(f"{shape}_{output}", unit(output), -width, width, 0.0, linear=True)


@dataclass(frozen=True, kw_only=True)
class Effect:
    """What an effect is called, what it is easily taken for, its parameters, and what it does.

    What separates it from the others of its `family` is the `manoeuvre`. One that is `per_channel`
    acts on its `channel` alone. `fixed` are the parameters that do not depend on the signals; a
    shape has an `amplitude` for each of its terms; shapes that are `apart` may each act alone; and
    what takes power, or gives less, has the loss of acceleration that is `taken` under a control.

    | hook, if it has it | gives |
    |---|---|
    | `bounds` | its parameters in the place of `fixed`, for signals and a channel |
    | `acts` | whether it can act on signals, and on a channel |
    | `starts` | parameters to begin with, in the place of all combinations of starts |
    | `arrives` | what reaches the engine (batch, time) of its channel, or of what drives it |
    | `shifts` | outputs (batch, time, outputs) with it, for those without: a delay commutes with an engine that does not change with time, so that no emulator is as exact |
    | `pace` | the engine's pace against the simulator's, for theta (batch, parameters) |
    | `reads` | what is read of its channel (batch, time), or of all outputs |
    | `terms` | pairs (name of a shape, output that it moves), one per amplitude; none if not at hand |
    | `shapes` | values (batch, time) of each shape for the simulator's own outputs; with `settled` they shift where the engine settles, else what is read |
    """  # noqa: E501 - a table

    id: str
    family: str
    side: Side
    meaning: str
    manoeuvre: str
    fixed: tuple[Parameter, ...] = ()
    channel: str | None = None
    per_channel: bool = False
    settled: bool = False
    apart: bool = False
    amplitude: Callable[[Signals, str, str], Parameter] = within_range
    taken: Parameter | None = None
    bounds: Callable[[Signals, str], tuple[Parameter, ...]] | None = None
    acts: Callable[[Signals, str | None], bool] | None = None
    starts: tuple[tuple[float, ...], ...] = ()
    arrives: Hook | None = None
    shifts: Hook | None = None
    pace: Callable[[FloatArray, Signals], Pace] | None = None
    reads: Hook | None = None
    terms: Callable[[Signals], Terms] | None = None
    shapes: Callable[[Run, FloatArray], Mapping[str, FloatArray]] | None = None

    @property
    def name(self) -> str:
        """`id`, or `id:channel`."""
        return self.id if self.channel is None else f"{self.id}:{self.channel}"

    @property
    def on_rates(self) -> bool:
        """Whether it acts on how fast the engine moves, and on nothing that has a shape."""
        return self.pace is not None and self.terms is None

    @property
    def takes_power(self) -> bool:
        """Whether it takes power from the core, whatever else it does."""
        return self.taken is not None and self.pace is None

    def of(self, channel: str) -> Effect:
        return replace(self, channel=channel)

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        own = self.fixed if self.bounds is None else self.bounds(signals, self.channel or "")
        sizes = [self.amplitude(signals, *term) for term in self._terms(signals)]
        taken = [self.taken] if self.taken is not None and signals.governed else []
        return (*own, *sizes, *taken)

    def nodes(self, signals: Signals) -> tuple[tuple[float, ...], ...]:
        """Parameters to begin with: all combinations of starts, 0 for linear ones."""
        choices = [(0.0,) if p.linear else p.starts for p in self.parameters(signals)]
        return self.starts or tuple(product(*choices))

    def acting(self, signals: Signals) -> list[tuple[int, ...]]:
        """Places of the parameters with slopes, of all shapes and of each that may act alone."""
        every = [j for j, p in enumerate(self.parameters(signals)) if not p.all_or_nothing]
        shapes = dict(enumerate((shape for shape, _ in self._terms(signals)), len(self.fixed)))
        alone = dict.fromkeys(shapes.values()) if self.apart else ()
        some = [tuple(j for j in every if shapes.get(j, one) == one) for one in alone]
        return list(dict.fromkeys([tuple(every), *some]))

    def applies(self, signals: Signals) -> bool:
        """Whether the signals hold what the effect acts on."""
        if self.acts is not None:
            return self.acts(signals, self.channel)
        if self.terms is not None:
            return len(self.terms(signals)) > 0
        return self.channel is None or self.channel in signals.outputs

    def on_input(self, run: Run, u: FloatArray) -> FloatArray:
        """Inputs (batch, time, inputs) that arrive of inputs `u`."""
        if self.arrives is None:
            return u
        column = run.signals.u(self.channel or run.signals.driver)
        return _with_column(u, column, self.arrives(run, u[..., column]))

    def on_output(self, run: Run, y: FloatArray) -> FloatArray:
        """Readings (batch, time, outputs) of outputs `y`."""
        if self.terms is not None and not self.settled:
            return y + self.total(run, y)
        if self.reads is None or self.channel is None:
            return y if self.reads is None else self.reads(run, y)
        column = run.signals.y(self.channel)
        return _with_column(y, column, self.reads(run, y[..., column]))

    def total(self, run: Run, y: FloatArray) -> FloatArray:
        """Amplitudes times shapes, (batch, time, outputs)."""
        shapes = {} if self.shapes is None else self.shapes(run, y)
        found, amplitudes = np.zeros_like(y), run.theta[:, len(self.fixed) :]
        for j, (shape, output) in enumerate(self._terms(run.signals)):
            found[..., run.signals.y(output)] += amplitudes[:, j, None] * shapes[shape]
        return found

    def loads(self, theta: FloatArray, signals: Signals) -> bool:
        return self.takes_power and signals.governed and bool((theta[:, -1] != 0.0).any())

    def load(self, run: Run, y: FloatArray) -> FloatArray:
        """What it takes (batch, time) in %/s of core speed at full speed and sea level.

        The loss times the shift of the temperature, as a share of its range.
        """
        if not run.signals.governed:
            return np.zeros(y.shape[:-1])
        hot = run.signals.hot
        share = self.total(run, y)[..., hot] / (run.signals.high[hot] - run.signals.low[hot])
        return np.asarray(run.theta[:, -1:] * share)

    def _terms(self, signals: Signals) -> Terms:
        return () if self.terms is None else self.terms(signals)


def _with_column(values: FloatArray, column: int, changed: FloatArray) -> FloatArray:
    found = values.copy()
    found[..., column] = changed
    return found


def unit(output: str) -> str:
    """Unit of an output, by the ending of its name."""
    return described(output).unit
