"""One network per output, merged into one network of all outputs that computes the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from narxcal.narx import NarxNet
from narxcal.narx_model import NarxModel, Scaling
from narxcal.records import Record


def single_output(record: Record, k: int) -> Record:
    """The record with output `k` alone."""
    return Record(record.u, record.y[:, k : k + 1], record.name, record.weight)


def merge_models(models: Sequence[NarxModel]) -> NarxModel:
    """Join single-output networks over the same inputs side by side.

    Weights between their parts are zero, so every output is exactly what it was alone. One
    model alone is returned as it is.
    """
    if len(models) == 1:
        return models[0]
    first = models[0]
    count = len(models)
    config = first.config.model_copy(update={"hidden": first.config.hidden * count})
    net = NarxNet(config, first.net.inputs, count)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.zero_()
        for k, model in enumerate(models):
            _place(model.net, net, k)
    scales = [model.output_scaling for model in models]
    outputs = Scaling(
        np.concatenate([scale.centre for scale in scales]),
        np.concatenate([scale.scale for scale in scales]),
    )
    return NarxModel(net, first.input_scaling, outputs)


def _place(part: NarxNet, whole: NarxNet, k: int) -> None:
    """Copy a single-output network into `whole` as the one of output `k`."""
    lags, units = part.config.lags, part.config.hidden
    tapped = part.inputs * len(part.config.taps)  # features behind those that are fed back
    rows, fed = slice(k * units, (k + 1) * units), torch.arange(lags) * whole.outputs + k
    whole.hidden.weight[rows, fed] = part.hidden.weight[:, :lags]
    whole.hidden.weight[rows, -tapped:] = part.hidden.weight[:, -tapped:]
    whole.hidden.bias[rows] = part.hidden.bias
    whole.output.weight[k, rows] = part.output.weight[0]
    whole.output.bias[k] = part.output.bias[0]
    whole.linear.weight[k, fed] = part.linear.weight[0, :lags]
    whole.linear.weight[k, -tapped:] = part.linear.weight[0, -tapped:]
    whole.low[k], whole.high[k] = part.low[0], part.high[0]
