"""What `Narx` may choose among: forms of models that simulate, and weighted means of them.

`pack` and `unpack` store any of them, by its kind.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from narxcal.narx.latent import LatentModel
from narxcal.narx.network import NarxModel, Scaling
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError


class DynamicModel(Protocol):
    """A model that runs free from a start, and predicts some steps ahead."""

    @property
    def inputs(self) -> int: ...
    @property
    def outputs(self) -> int: ...
    @property
    def output_scaling(self) -> Scaling: ...
    def simulate(self, u: FloatArray, start: FloatArray) -> FloatArray: ...
    def predict(self, u: FloatArray, y: FloatArray, steps: int) -> FloatArray: ...
    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]: ...


_LEAD = 1000  # samples at the first input: twice the longest memory of a latent model


def from_rest(model: DynamicModel, u: FloatArray) -> FloatArray:
    """Free run (time, outputs) over `u` (time, inputs) from the equilibrium at its first sample."""
    if not len(u):
        return np.empty((0, model.outputs))
    before = np.repeat(u[:1], _LEAD, axis=0)
    rest = model.simulate(before, model.output_scaling.centre[None])[-1:]
    return model.simulate(np.concatenate([u[:1], u]), rest)[1:]


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
        return self.members[0].inputs

    @property
    def outputs(self) -> int:
        return self.members[0].outputs

    @property
    def output_scaling(self) -> Scaling:
        return self.members[0].output_scaling

    def simulate(self, u: FloatArray, start: FloatArray) -> FloatArray:
        return self._joined([member.simulate(u, start) for member in self.members])

    def predict(self, u: FloatArray, y: FloatArray, steps: int = 1) -> FloatArray:
        """`steps` ahead (time, outputs); NaN where a member has none."""
        return self._joined([member.predict(u, y, steps) for member in self.members])

    def _joined(self, runs: Sequence[FloatArray]) -> FloatArray:
        if not self.weights:
            return np.asarray(np.median(np.stack(runs), axis=0))
        return np.asarray(np.tensordot(np.array(self.weights), np.stack(runs), axes=1))

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        arrays: dict[str, FloatArray] = {}
        meta: list[dict[str, Any]] = []
        for k, member in enumerate(self.members):
            own, parts = pack(member)
            meta.append(own)
            arrays |= {f"{k}.{name}": array for name, array in parts.items()}
        return {"members": meta, "weights": list(self.weights)}, arrays


_KINDS: Mapping[type, str] = {NarxModel: "network", LatentModel: "latent", Ensemble: "ensemble"}


def pack(model: DynamicModel) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Structure of any form with its kind, and its arrays."""
    meta, arrays = model.to_arrays()
    return {"kind": _KINDS[type(model)], **meta}, arrays


def unpack(meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> DynamicModel:
    """Rebuild what `pack` made; `ModelError` where a part is missing or unusable."""
    kind = meta.get("kind")
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
