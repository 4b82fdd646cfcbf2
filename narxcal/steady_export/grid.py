"""The nodes between which an exported table interpolates, and where they come from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from narxcal.channels import CHANNELS
from narxcal.errors import ConfigError
from narxcal.steady_export.ranges import model_ranges
from narxcal.steady_state import Floats, SteadyStateModel
from narxcal.steady_table import SteadyTable


@dataclass(frozen=True)
class Grid:
    """Nodes per input, in the order of the model's inputs.

    A switch has the nodes 0 and 1. An input of one node is fixed there and left out of what
    is exported. Raises `ConfigError` for nodes that do not increase or are no numbers.
    """

    axes: Mapping[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        for name, nodes in self.axes.items():
            if not nodes:
                raise ConfigError("an axis needs at least one node, got none", channel=name)
            rising = all(low < high for low, high in pairwise(nodes))
            if not (rising and all(map(math.isfinite, nodes))):
                shown = ", ".join(f"{node:g}" for node in nodes)
                raise ConfigError(f"nodes have to increase, got {shown}", channel=name)
        if self.axes and not self.varying:
            raise ConfigError(
                "every input is fixed, so nothing is left to tabulate",
                hint="Give at least one input two nodes",
            )

    @classmethod
    def of_model(
        cls, model: SteadyStateModel, nodes: Mapping[str, Sequence[float]] | None = None
    ) -> Self:
        """Take `nodes` where they are given and the ends of the model's envelope elsewhere.

        A gridded table has all its own nodes, so that it is exported as it is.

        Raises `ConfigError` for nodes of what is no input or outside the envelope, and
        `ModelError` where the model has no envelope to be found.
        """
        given = dict(nodes or {})
        for name in given:
            if name not in model.input_names:
                raise ConfigError(
                    f"'{name}' is no input of the model",
                    hint=f"Inputs are {', '.join(model.input_names)}",
                )
        if isinstance(model, SteadyTable) and model.gridded and model.method == "linear":
            columns = zip(model.input_names, model.points.T, strict=True)
            given = {name: np.unique(column).tolist() for name, column in columns} | given
        found = model_ranges(model, given)
        axes = {name: tuple(given.get(name) or _ends(name, found)) for name in model.input_names}
        return cls(axes)

    @property
    def varying(self) -> tuple[str, ...]:
        """Inputs that the exported table has."""
        return tuple(name for name, nodes in self.axes.items() if len(nodes) > 1)

    @property
    def fixed(self) -> dict[str, float]:
        """Inputs held at one value."""
        return {name: nodes[0] for name, nodes in self.axes.items() if len(nodes) == 1}

    @property
    def rows(self) -> int:
        """How many conditions the full grid has."""
        return math.prod(len(nodes) for nodes in self.axes.values())

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Random conditions `(count, n_in)`: switches at 0 or 1, the others between the ends."""
        columns = [
            rng.choice(np.array(nodes), count)
            if is_switch(name) or len(nodes) == 1
            else rng.uniform(nodes[0], nodes[-1], count)
            for name, nodes in self.axes.items()
        ]
        return np.column_stack(columns)


def is_switch(name: str) -> bool:
    """Whether a channel knows only 0 and 1."""
    return name in CHANNELS and CHANNELS[name].role == "switch"


def candidates(nodes: Sequence[float], most: int) -> Floats:
    """`nodes` and round numbers between them, at most about `most`, where nodes may be added."""
    low, high = nodes[0], nodes[-1]
    step = _round_up((high - low) / most)
    between = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1)
    # Multiples of 0.01 as they are written, not as 7 * 0.01 comes out.
    between = np.array([float(f"{value:.9g}") for value in between])
    apart = np.abs(between[:, None] - np.array(nodes)).min(axis=1) > 0.3 * step
    return np.union1d(np.array(nodes), between[apart])


def _round_up(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))


def _ends(name: str, found: Mapping[str, tuple[float, float]]) -> tuple[float, ...]:
    low, high = found[name]
    return (low, high) if low < high else (low,)
