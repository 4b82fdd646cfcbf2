"""What `Narx` may choose among: forms of models that simulate, and weighted means of them.

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
from narxcal.support.arrays import FloatArray
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
