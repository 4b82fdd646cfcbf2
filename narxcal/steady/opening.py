"""Open a steady-state model by its kind, from a source or from a bundle."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from narxcal.steady.model import (
    REGISTRY,
    Arrays,
    Executes,
    Names,
    SteadyOptions,
    SteadyStateModel,
    StorableSteadyState,
)
from narxcal.support.errors import ConfigError, ModelError

# A kind's module is imported only when a model of that kind is opened, and registers its class.
_MODULES = {
    "table": "narxcal.steady.table",
    "callable": "narxcal.steady.function",
    "fmu": "narxcal.steady.fmu",
    "fitted": "narxcal.steady.fitted",
    "static": "narxcal.static_models.model",
}


def open_steady(
    kind: str,
    source: str,
    names: Names,
    folder: str | PathLike[str] = ".",
    options: SteadyOptions | None = None,
) -> SteadyStateModel:
    """Open `source` as `kind` "table" (a CSV file), "callable" (`module:function`) or "fmu".

    `names` are the input and output channels; files and modules are looked for relative to
    `folder`. This runs the function or FMU named: call it with what the user
    names, never with what a file says. Raises `ConfigError`, `DataError` or `ModelError` as the
    kind itself does.
    """
    chosen, path = options or SteadyOptions(), Path(folder) / source
    # Each kind is imported only where it is used: FMPy and pandas are slow to import.
    if kind == "table":
        from narxcal.steady.table import read_steady_table  # noqa: PLC0415

        return read_steady_table(path, *names, chosen.method)
    if kind == "callable":
        from narxcal.steady.function import SteadyCallable  # noqa: PLC0415

        return SteadyCallable.load(source, names, chosen.ranges, folder)
    if kind == "fmu":
        from narxcal.steady.fmu import SteadyFmu  # noqa: PLC0415

        return SteadyFmu(path, names, chosen)
    raise ConfigError(
        f"unknown kind of steady-state source '{kind}'", hint="Use table, callable or fmu"
    )


def steady_to_json(
    model: SteadyStateModel,
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Split a model into a JSON-able dict with its `kind` and a dict of arrays."""
    if not isinstance(model, StorableSteadyState):
        raise ModelError(
            f"steady-state model {type(model).__name__} cannot be stored in a bundle",
            hint="Give it kind, to_arrays and from_arrays, or load it as module:function",
        )
    meta, arrays = model.to_arrays()
    return {"kind": model.kind, **meta}, arrays


def steady_from_json(
    meta: Mapping[str, Any], arrays: Arrays, *, trust: bool = False
) -> SteadyStateModel:
    """Rebuild what `steady_to_json` split.

    A model that runs code, a Python function or an FMU, is opened only with `trust`. Raises
    `ModelError` for an unknown kind, and without trust naming what would run.
    """
    kind = str(meta.get("kind"))
    if kind not in REGISTRY and kind in _MODULES:
        importlib.import_module(_MODULES[kind])
    if kind not in REGISTRY:
        known = ", ".join(sorted({*REGISTRY, *_MODULES}))
        raise ModelError(
            f"unknown kind of steady-state model '{kind}'", hint=f"Known kinds: {known}"
        )
    model = REGISTRY[kind]
    if not trust and issubclass(model, Executes) and model.executed(meta):
        raise _would_run(str(model.executed(meta)))
    return model.from_arrays(meta, arrays)


def refuse_code(section: Mapping[str, Any]) -> None:
    """Refuse [steady_state] of a run that would execute something where it is opened."""
    kind, source = section.get("kind"), str(section.get("source", ""))
    if kind == "callable":
        from narxcal.steady.function import BUILT_IN  # noqa: PLC0415 -- only where it is used

        if source in BUILT_IN:
            return
    if kind in {"callable", "fmu"}:
        raise _would_run(f"'{source}' of its configuration")


def _would_run(what: str) -> ModelError:
    return ModelError(
        f"opening this model would run {what}",
        hint="If you would run a program of its author, allow it by --trust, in Python by "
        "load_bundle(folder, trust=True)",
    )
