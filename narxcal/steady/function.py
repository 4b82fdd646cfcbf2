"""A steady-state model given as a Python function, `module:function`.

Results for whole logs are cached, since a training evaluates the same logs again and again.
Importing a module runs it: a function stored in a bundle is imported only with trust
(`steady.opening`) and only from a file with the stored hash.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from os import PathLike
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.steady.model import (
    Arrays,
    BoxModel,
    Envelope,
    Names,
    register_steady,
    stored,
    stored_names,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import is_file, sha256_of

# Part of narxcal, a function of its inputs without side effects: opening it needs no trust.
BUILT_IN = ("narxcal.turbofan:maker_model",)
_FEWEST_ROWS = 100  # fewer are samples of a stream, which do not come again
_MOST_ROWS = 1_000_000  # cached in all: some 10 h at 32 Hz, 24 MB of three outputs
_WHAT = "steady-state function"
_SUBJECT = "steady-state model"

Function = Callable[[FloatArray], ArrayLike]
Ranges = Mapping[str, tuple[float, float]]


class Cached:
    """`function((n, n_in)) -> (n, n_out)` with its most recently used results cached.

    Up to `most_rows` rows are kept in all; results are returned read-only.
    """

    def __init__(
        self, function: Callable[[FloatArray], FloatArray], most_rows: int = _MOST_ROWS
    ) -> None:
        self._function = function
        self._most_rows = most_rows
        self._results: OrderedDict[bytes, FloatArray] = OrderedDict()

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Evaluate inputs (n, n_in), or return the cached result (n, n_out)."""
        if not _FEWEST_ROWS <= len(inputs) <= self._most_rows:
            return self._function(inputs)
        key = hashlib.sha256(np.ascontiguousarray(inputs).tobytes()).digest()
        result = self._results.pop(key, None)
        if result is None:
            result = self._function(inputs).copy()
            result.flags.writeable = False
        self._results[key] = result
        while sum(map(len, self._results.values())) > self._most_rows:
            self._results.popitem(last=False)
        return result


@register_steady
class SteadyCallable(BoxModel):
    """Wraps `function((n, n_in)) -> (n, n_out)`, both in canonical units.

    `names` are the input and the output names, `ranges` the envelope `{input: (low, high)}`;
    an input without a range is unbounded. Inputs are clamped to the envelope before they reach the
    function, whose result must depend on them alone (results for whole logs are cached).

    Raises `ModelError` if the function returns another shape or no numbers.
    """

    kind: ClassVar[str] = "callable"

    def __init__(
        self,
        function: Function,
        names: Names,
        ranges: Ranges | None = None,
        reference: str | None = None,
        file: str | None = None,
    ) -> None:
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.reference = reference
        self.file = file
        self._function = function
        self.envelope = Envelope.from_ranges(self.input_names, ranges)
        self._cached = Cached(self._call)

    @classmethod
    def load(
        cls,
        reference: str,
        names: Names,
        ranges: Ranges | None = None,
        folder: str | PathLike[str] = ".",
    ) -> Self:
        """Import `module:function`; a module that is not installed is looked for in `folder`."""
        function, file = import_function(reference, folder)
        return cls(function, names, ranges, reference, str(file))

    def __reduce__(self) -> tuple[Any, ...]:
        """Send a worker process the reference: a module loaded from a file has no import name."""
        if self.reference is None or self.file is None:
            return super().__reduce__()  # type: ignore[return-value]
        ranges = _ranges(self.input_names, self.envelope.low, self.envelope.high)
        names = (self.input_names, self.output_names)
        return type(self).load, (self.reference, names, ranges, Path(self.file).parent)

    def _evaluate(self, inputs: FloatArray) -> FloatArray:
        return self._cached(inputs)

    def _call(self, inputs: FloatArray) -> FloatArray:
        expected = (len(inputs), len(self.output_names))
        name = f"'{self.reference}'" if self.reference else "function"
        try:
            found = np.asarray(self._function(inputs), dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ModelError(
                f"steady-state model {name} failed on inputs {inputs.shape}: {error}",
                hint="It takes one array (samples, inputs) and returns (samples, outputs)",
            ) from error
        if found.shape != expected:
            raise ModelError(
                f"steady-state model {name} returned {found.shape}, expected {expected}"
            )
        return found

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        if self.reference is None or self.file is None:
            raise ModelError(
                "a steady-state function without a module cannot be stored in a bundle",
                hint="Load it as module:function",
            )
        meta = {
            "reference": self.reference,
            "file": self.file,
            "sha256": sha256_of(Path(self.file)),
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
        }
        return meta, {"low": self.envelope.low, "high": self.envelope.high}

    @classmethod
    def executed(cls, meta: Mapping[str, Any]) -> str:
        """Name the function that would be imported, its file and hash; nothing is imported."""
        reference = stored(meta, "reference", _WHAT)
        if reference in BUILT_IN:
            return ""
        file, sha256 = stored(meta, "file", _WHAT), str(stored(meta, "sha256", _WHAT))
        return f"the Python function '{reference}' of {file} (sha256 {sha256[:12]})"

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Import the function again, but only from a file with the stored hash.

        Raises `ModelError` if the module is missing or was changed; a changed one is not run.
        """
        reference = str(stored(meta, "reference", _WHAT))
        names = stored_names(meta, _WHAT)
        module, name = _split(reference, _SUBJECT)
        former = Path(stored(meta, "file", _WHAT))
        file = _find(module, former.parent)
        if file is None:
            raise ModelError(
                f"the steady-state model '{reference}' of this bundle is not installed",
                hint=f"Put {former.name} into {former.parent}, or install it",
            )
        if sha256_of(file) != stored(meta, "sha256", _WHAT):
            raise ModelError(
                f"the steady-state model '{reference}' is not the one the bundle was trained on",
                file=file,
                hint="Restore the former file, or train anew",
            )
        ranges = _ranges(names[0], stored(arrays, "low", _WHAT), stored(arrays, "high", _WHAT))
        function = _function(_import(module, file), name, f"{_SUBJECT} '{reference}'")
        return cls(function, names, ranges, reference, str(file))


def _ranges(names: tuple[str, ...], low: FloatArray, high: FloatArray) -> Ranges:
    pairs = zip(low.tolist(), high.tolist(), strict=True)
    return dict(zip(names, pairs, strict=True))


def import_function(
    reference: str, folder: str | PathLike[str] = ".", subject: str = _SUBJECT
) -> tuple[Callable[..., Any], Path]:
    """Import `module:function`, installed or of a file in `folder`; return it and its file.

    A module in `folder` is loaded under a name of its own, which hides no installed module, and
    again if its file changed; it may import others of its folder. Errors begin with `subject`.
    Raises `ConfigError` if there is no such module or function, or if the module fails.
    """
    module, name = _split(reference, subject)
    what = f"{subject} '{reference}'"
    file = _find(module, Path(folder))
    if file is None:
        place = module.replace(".", "/")
        raise ConfigError(
            f"{what}: there is no module '{module}'",
            hint=f"Install it, or put {place}.py into {Path(folder).resolve()}",
        )
    return _function(_import(module, file, siblings=True), name, what), file


@contextmanager
def search_path(folder: Path) -> Iterator[None]:
    """Let imports find modules of `folder`, after all others, while the block runs."""
    before = list(sys.path)
    sys.path.append(str(folder))
    try:
        yield
    finally:
        sys.path[:] = before


def _split(reference: str, subject: str) -> tuple[str, str]:
    module, colon, name = reference.partition(":")
    if not (colon and name.isidentifier() and all(map(str.isidentifier, module.split(".")))):
        raise ConfigError(
            f"{subject} '{reference}' is no reference to a function",
            hint="Write it as module:function",
        )
    return module, name


def _find(module: str, folder: Path) -> Path | None:
    """Find the module's file, on the import path or in `folder`."""
    installed = _installed(module)
    if installed is not None:
        return installed
    local = folder.joinpath(*module.split("."))
    files = (local.with_suffix(".py"), local / "__init__.py")
    return next((file.resolve() for file in files if is_file(file)), None)


def _installed(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module)
    except (ModuleNotFoundError, ValueError):
        return None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return None
    return Path(spec.origin).resolve()


def _import(module: str, file: Path, *, siblings: bool = False) -> ModuleType:
    if _installed(module) == file:
        return importlib.import_module(module)
    # A name of its own: it hides no installed module, and a changed file is another module.
    own = f"_narxcal_{sha256_of(file)[:12]}_{module.replace('.', '_')}"
    if own in sys.modules:
        return sys.modules[own]
    spec = importlib.util.spec_from_file_location(own, file)
    if spec is None or spec.loader is None:
        raise ConfigError("the module cannot be imported", file=file)
    sys.modules[own] = importlib.util.module_from_spec(spec)
    try:
        with search_path(file.parent) if siblings else nullcontext():
            spec.loader.exec_module(sys.modules[own])
    except (Exception, SystemExit) as error:
        del sys.modules[own]
        lost = isinstance(error, ModuleNotFoundError)
        raise ConfigError(
            f"the module cannot be imported: {type(error).__name__}: {error}",
            file=file,
            hint=f"Install it, or put it into {file.parent}" if lost else None,
        ) from error
    return sys.modules[own]


def _function(module: ModuleType, name: str, what: str) -> Callable[..., Any]:
    found = getattr(module, name, None)
    if not callable(found):
        raise ConfigError(f"{what}: the module has no function '{name}'")
    function: Callable[..., Any] = found
    return function
