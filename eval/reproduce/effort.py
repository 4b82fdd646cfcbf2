"""How much work the studies may take, and fitting many networks side by side."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from narxcal.narx_config import NarxConfig
from narxcal.narx_model import NarxModel
from narxcal.records import Record
from training.config import RunConfig, TrainConfig
from training.parallel import in_processes
from training.rest import rest_records
from training.trainer import Material, fit_narx


class Effort(NamedTuple):
    """`iterations` (one per horizon of [train]) and `splits` replace those of the configuration.

    Empty iterations keep the configuration's. `jobs` is the number of processes; no number
    depends on it.
    """

    iterations: tuple[int, ...] = ()
    splits: int = 10
    jobs: int = 1


class Task(NamedTuple):
    """One network to fit: its records, its structure and the raster."""

    records: Sequence[Record]
    structure: NarxConfig
    dt_s: float


def within(config: RunConfig, effort: Effort) -> RunConfig:
    """`config` with the effort's iterations, as many as it has horizons."""
    if not effort.iterations:
        return config
    count = len(config.train.horizons_s)
    iterations = (effort.iterations * count)[:count]
    train = config.train.model_copy(update={"iterations": iterations})
    return config.model_copy(update={"train": train})


def fit_all(tasks: Sequence[Task], config: RunConfig, jobs: int) -> list[NarxModel]:
    """Fit one network per task, in processes of one thread each; the order is kept.

    An anchored structure (`moving` > 0) is also shown how to come to rest, as `train` does.
    """
    train = config.train.model_copy(update={"threads": 1})
    return list(in_processes(partial(_fit, train=train), tasks, jobs))


def _fit(task: Task, train: TrainConfig) -> NarxModel:
    steps, moving = round(train.rest_s / task.dt_s), task.structure.moving
    rest = rest_records(task.records, moving, steps, train.seed) if moving and steps > 1 else []
    return fit_narx(Material(task.records, [], task.dt_s, rest), task.structure, train).model
