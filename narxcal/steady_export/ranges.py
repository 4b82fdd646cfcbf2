"""How far a steady-state model holds along each of its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from narxcal.channels import channel
from narxcal.errors import ModelError
from narxcal.steady_fitted import FittedSteadyState
from narxcal.steady_state import Envelope, Floats, SteadyStateModel
from narxcal.steady_table import SteadyTable

# What is sampled where neither the user nor the model says how far it holds: the envelope of
# a business jet.
USUAL_RANGES = {
    "TRA_deg": (0.0, 85.0),
    "ALT_ft": (0.0, 43000.0),
    "Mach": (0.0, 0.8),
    "dT_C": (-30.0, 35.0),
}
_DRAWS, _STARTS, _HALVINGS = 4096, 64, 80

Range = tuple[float, float]


def model_ranges(
    model: SteadyStateModel, nodes: Mapping[str, Sequence[float]]
) -> dict[str, tuple[float, float]]:
    """Ends of each input: those of `nodes`, else of the model's envelope, else the usual ones.

    A model that is no table is asked: from random conditions inside, each input is moved until
    `inside` says that the envelope ends. Raises `ModelError` where no condition is inside and
    `ConfigError` for an input that is no channel.
    """
    widest = {name: (channel(name).low, channel(name).high) for name in model.input_names}
    given = {name: (float(ends[0]), float(ends[-1])) for name, ends in nodes.items()}
    box = _known_box(model)
    if box is not None:
        return {**box, **given}
    usual = {name: USUAL_RANGES.get(name, widest[name]) for name in model.input_names} | given
    inside = _inside(model, usual)
    if not len(inside):
        inside = _inside(model, widest | given)
    if not len(inside):
        raise ModelError(
            "the model says that it holds nowhere in the range tried",
            hint="Give the ends of its inputs as nodes",
        )
    for name in usual.keys() - given.keys():
        reach = _reach(model, inside, name, widest[name])
        # What reaches every bound of the channel has none of its own.
        usual[name] = usual[name] if reach == widest[name] else reach
    return usual


def _known_box(model: SteadyStateModel) -> dict[str, Range] | None:
    if isinstance(model, SteadyTable):
        box = Envelope.of(model.points)
    elif isinstance(model, FittedSteadyState):
        box = model.envelope
    else:
        return None
    pairs = zip(box.low.tolist(), box.high.tolist(), strict=True)
    return dict(zip(model.input_names, pairs, strict=True))


def _inside(model: SteadyStateModel, ranges: Mapping[str, Range]) -> Floats:
    """Up to 64 random conditions, (n, n_in), that the model calls inside."""
    rng = np.random.default_rng(0)
    low, high = np.array(list(ranges.values())).T
    share = rng.uniform(size=(_DRAWS, len(low)))
    switch = [channel(name).role == "switch" for name in ranges]
    share[:, switch] = np.round(share[:, switch])
    drawn = low + share * (high - low)
    found: Floats = drawn[model.inside(drawn)][:_STARTS]
    return found


def _reach(model: SteadyStateModel, inside: Floats, name: str, widest: Range) -> Range:
    column = model.input_names.index(name)
    low, high = (_farthest(model, inside, column, end) for end in widest)
    return float(low.min()), float(high.max())


def _farthest(model: SteadyStateModel, inside: Floats, column: int, end: float) -> Floats:
    """Bisect from each condition towards `end`: the last value still inside, (n,)."""
    near, probe = inside[:, column].copy(), inside.copy()
    far = np.full_like(near, end)
    probe[:, column] = far
    near = np.where(model.inside(probe), far, near)
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        probe[:, column] = middle
        held = model.inside(probe)
        near, far = np.where(held, middle, near), np.where(held, far, middle)
    # An end at zero is never quite met by halving.
    probe[:, column] = round_ = np.round(near, 9)
    return np.where(model.inside(probe), round_, near)
