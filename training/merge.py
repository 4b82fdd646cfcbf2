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
    count, units = len(models), first.config.hidden
    width = models[0].net.inputs * len(first.config.taps)
    config = first.config.model_copy(update={"hidden": units * count})
    net = NarxNet(config, first.net.inputs, count)
    lags = first.config.lags
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.zero_()
        for k, model in enumerate(models):
            rows = slice(k * units, (k + 1) * units)
            fed = torch.arange(lags) * count + k
            net.hidden.weight[rows, fed] = model.net.hidden.weight[:, :lags]
            net.hidden.weight[rows, -width:] = model.net.hidden.weight[:, -width:]
            net.hidden.bias[rows] = model.net.hidden.bias
            net.output.weight[k, rows] = model.net.output.weight[0]
            net.output.bias[k] = model.net.output.bias[0]
            net.linear.weight[k, fed] = model.net.linear.weight[0, :lags]
            net.linear.weight[k, -width:] = model.net.linear.weight[0, -width:]
            net.low[k], net.high[k] = model.net.low[0], model.net.high[0]
    scales = [model.output_scaling for model in models]
    outputs = Scaling(
        np.concatenate([scale.centre for scale in scales]),
        np.concatenate([scale.scale for scale in scales]),
    )
    return NarxModel(net, first.input_scaling, outputs)
