"""What `Narx` may choose among: forms of models that simulate, weighted means of them, and bands.

Every form has `inputs`, `outputs`, `simulate(u, start)`, `predict(u, y)`, `to_arrays`. `pack` and
`unpack` store any of them, by its kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from narxcal.narx.latent import LatentModel
from narxcal.narx.network import NarxModel
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import ModelError


class DynamicModel(Protocol):
    """A model that runs free from a start, and predicts one step ahead."""

    @property
    def inputs(self) -> int: ...  # noqa: D102
    @property
    def outputs(self) -> int: ...  # noqa: D102
    def simulate(self, u: FloatArray, start: FloatArray) -> FloatArray: ...  # noqa: D102
    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray: ...  # noqa: D102
    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]: ...  # noqa: D102


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Weighted mean of the free runs of several models, or without weights their median.

    The median does not follow a single member that leaves the others.
    """

    members: tuple[DynamicModel, ...]
    weights: tuple[float, ...] = ()

    @classmethod
    def median(cls, members: Sequence[DynamicModel]) -> DynamicModel:
        """The median of several models; of one alone it is that one."""
        return members[0] if len(members) == 1 else cls(tuple(members))

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self.members[0].inputs

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return self.members[0].outputs

    def simulate(self, u: FloatArray, start: FloatArray) -> FloatArray:
        """Free run (time, outputs) over `u` (time, inputs) from `start` (n, outputs)."""
        return self._joined([member.simulate(u, start) for member in self.members])

    def predict(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """One step ahead (time, outputs); NaN where a member has none."""
        return self._joined([member.predict(u, y) for member in self.members])

    def _joined(self, runs: Sequence[FloatArray]) -> FloatArray:
        if not self.weights:
            return np.asarray(np.median(np.stack(runs), axis=0))
        return np.asarray(np.tensordot(np.array(self.weights), np.stack(runs), axes=1))

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        """Split into JSON-able structure and named arrays."""
        arrays: dict[str, FloatArray] = {}
        meta: list[dict[str, Any]] = []
        for k, member in enumerate(self.members):
            own, parts = pack(member)
            meta.append(own)
            arrays |= {f"{k}.{name}": array for name, array in parts.items()}
        return {"members": meta, "weights": list(self.weights)}, arrays


@dataclass(frozen=True)
class Band:
    """A free run with its interval, each (time, outputs); start samples have no width."""

    y: FloatArray
    low: FloatArray
    high: FloatArray


_ENOUGH = 8  # held-out pieces; with fewer, intervals are widened


@dataclass(frozen=True, eq=False)
class Conformal:
    """Absolute errors of free runs that were held out, by the samples since their start.

    `errors` (count, outputs) in the outputs' units belong to the horizons `after` (count,) and to
    the held-out pieces numbered in `piece` (count,).
    """

    after: FloatArray
    errors: FloatArray
    piece: IntArray

    @property
    def pieces(self) -> int:
        """How many pieces were held out; intervals of fewer than eight are widened."""
        return len(np.unique(self.piece)) if np.isfinite(self.errors).any() else 0

    def half_width(self, steps: int, share: float) -> FloatArray:
        """Half width (steps, outputs) of the interval that covers `share` of samples.

        Quantiles within horizons of similar logarithm, never narrower than nearer ones. Their level
        is the least at which each piece is covered by the errors of the others to this share on
        average; with n pieces less than eight it goes (8 - n) / 8 of the way to 1.
        """
        last = int(max(steps, self.after.max(), 2))
        edges = np.unique(np.geomspace(1, last, 9).astype(int))
        level = self._level(edges, share)
        if self.pieces < _ENOUGH:
            level += (1.0 - level) * (_ENOUGH - self.pieces) / _ENOUGH
        wide = self._quantiles(np.ones(len(self.after), dtype=np.bool_), edges, level)
        at = np.clip(np.searchsorted(edges, np.arange(1, steps + 1), side="right") - 1, 0, None)
        return wide[np.minimum(at, len(wide) - 1)]

    def _level(self, edges: IntArray, share: float) -> float:
        """Least level at which pieces are covered by the others, judged on at most 5000 errors."""
        every = max(len(self.after) // 5000, 1)
        thin = np.arange(len(self.after)) % every == 0
        at = np.clip(np.searchsorted(edges, self.after, side="right") - 1, 0, len(edges) - 1)
        for level in np.linspace(share, 1.0, 11):
            covered = []
            for number in np.unique(self.piece):
                own = thin & (self.piece == number)
                others = thin & (self.piece != number)
                if own.any() and others.any():
                    wide = self._quantiles(others, edges, float(level))
                    known = np.isfinite(self.errors[own])
                    covered.append((self.errors[own] <= wide[at[own]])[known].mean())
            if covered and np.mean(covered) >= share:
                return float(level)
        return 1.0

    def _quantiles(self, chosen: BoolArray, edges: IntArray, level: float) -> FloatArray:
        """Quantile of the chosen errors from each edge on (edges, outputs), not falling."""
        after, errors = self.after[chosen], self.errors[chosen]
        found = np.zeros((len(edges), errors.shape[1]))
        ends = [*edges[1:].tolist(), np.inf]
        for k, (low, high) in enumerate(zip(edges.tolist(), ends, strict=True)):
            near = (after >= low) & (after < high)
            if near.sum() < 20:  # a 90 % quantile needs 10 samples; twice that
                near = after >= min(low, after.max() / 2.0)
            known = [column[np.isfinite(column)] for column in errors[near].T]
            found[k] = [np.quantile(column, level) if len(column) else 0.0 for column in known]
        return np.asarray(np.maximum.accumulate(found, axis=0))


_KINDS: Mapping[type, str] = {NarxModel: "network", LatentModel: "latent", Ensemble: "ensemble"}


def pack(model: DynamicModel) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Structure of any form with its kind, and its arrays."""
    meta, arrays = model.to_arrays()
    return {"kind": _KINDS[type(model)], **meta}, arrays


def unpack(meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> DynamicModel:
    """Rebuild what `pack` made; `ModelError` where a part is missing or unusable."""
    kind = meta.get("kind", "network")
    if kind == "network":
        return NarxModel.from_arrays(meta, arrays)
    if kind == "latent":
        return LatentModel.from_arrays(meta, arrays)
    if kind != "ensemble":
        raise ModelError(f"expected a model of kind {', '.join(_KINDS.values())}, found '{kind}'")
    members = []
    for k, own in enumerate(meta["members"]):
        head = f"{k}."
        parts = {n[len(head) :]: a for n, a in arrays.items() if n.startswith(head)}
        members.append(unpack(own, parts))
    return Ensemble(tuple(members), tuple(float(w) for w in meta["weights"]))
