"""A steady-state model given as a Python function, `module:function`.

What a costly function answered to whole logs: a training asks the same ones again and again.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from narxcal.steady.model import (
    Arrays,
    Envelope,
    Floats,
    at_known,
    checked_inputs,
    register_steady,
    stored,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError

if TYPE_CHECKING:
    from os import PathLike
    from types import ModuleType

    from numpy.typing import ArrayLike, NDArray

_FEWEST_ROWS = 100  # fewer are samples of a stream, which do not come again
_MOST_ROWS = 1_000_000  # kept in all: some 10 h at 32 Hz, 24 MB of three outputs


class Remembered:
    """`function((n, n_in)) -> (n, n_out)`, whose answers to the same inputs are the same.

    The answers used last are kept, up to `most_rows` in all, and handed out read-only.
    """

    def __init__(
        self, function: Callable[[FloatArray], FloatArray], most_rows: int = _MOST_ROWS
    ) -> None:
        self._function = function
        self._most_rows = most_rows
        self._answers: OrderedDict[bytes, FloatArray] = OrderedDict()

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Answer (n, n_out) to inputs (n, n_in)."""
        if not _FEWEST_ROWS <= len(inputs) <= self._most_rows:
            return self._function(inputs)
        key = hashlib.sha256(np.ascontiguousarray(inputs).tobytes()).digest()
        answer = self._answers.pop(key, None)
        if answer is None:
            answer = self._function(inputs).copy()
            answer.flags.writeable = False
        self._answers[key] = answer
        while sum(map(len, self._answers.values())) > self._most_rows:
            self._answers.popitem(last=False)
        return answer


Function = Callable[[Floats], "ArrayLike"]
Ranges = Mapping[str, tuple[float, float]]


@register_steady
class SteadyCallable:
    """Wraps `function((n, n_in)) -> (n, n_out)`, both in canonical units.

    `names` are the input and the output names, `ranges` the envelope `{input: (low, high)}`;
    an input without a range is unbounded. Inputs are clamped to the envelope before the
    function sees them. It has to be a function of them alone: what it answered to whole logs is
    remembered.

    Raises `ModelError` if the function returns another shape or no numbers.
    """

    kind: ClassVar[str] = "callable"

    def __init__(
        self,
        function: Function,
        names: tuple[Sequence[str], Sequence[str]],
        ranges: Ranges | None = None,
        reference: str | None = None,
        file: str | None = None,
    ) -> None:
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.reference = reference
        self.file = file
        self._function = function
        self._box = Envelope.from_ranges(self.input_names, ranges)
        self._answer = Remembered(self._evaluate)

    @classmethod
    def load(
        cls,
        reference: str,
        names: tuple[Sequence[str], Sequence[str]],
        ranges: Ranges | None = None,
        folder: str | PathLike[str] = ".",
    ) -> Self:
        """Import `module:function`; a module that is not installed is looked for in `folder`.

        Raises `ConfigError` if there is no such module or function.
        """
        module, name = _split(reference)
        file = _find(module, Path(folder))
        if file is None:
            place = module.replace(".", "/")
            raise ConfigError(
                f"steady-state model '{reference}': there is no module '{module}'",
                hint=f"Install it, or put {place}.py into {Path(folder).resolve()}",
            )
        function = _function(_import(module, file), name, reference)
        return cls(function, names, ranges, reference, str(file))

    def __reduce__(self) -> tuple[Any, ...]:
        """Send a worker process the reference, for it cannot import a file by its name."""
        if self.reference is None or self.file is None:
            return super().__reduce__()  # type: ignore[return-value]
        ranges = _ranges(self.input_names, self._box.low, self._box.high)
        names = (self.input_names, self.output_names)
        return type(self).load, (self.reference, names, ranges, Path(self.file).parent)

    def outputs(self, inputs: ArrayLike) -> Floats:
        """Settled outputs `(..., n_out)` at `inputs` `(..., n_in)`; NaN where an input is."""
        held = self._box.clamp(checked_inputs(inputs, self.input_names))
        return at_known(self._answer, held, len(self.output_names))

    def _evaluate(self, inputs: Floats) -> Floats:
        expected = (len(inputs), len(self.output_names))
        try:
            found = np.asarray(self._function(inputs), dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ModelError(
                f"steady-state model {self._name()} failed on inputs {inputs.shape}: {error}",
                hint="It takes one array (samples, inputs) and returns (samples, outputs)",
            ) from error
        if found.shape != expected:
            raise ModelError(
                f"steady-state model {self._name()} returned {found.shape}, expected {expected}"
            )
        return found

    def _name(self) -> str:
        return f"'{self.reference}'" if self.reference else "function"

    def inside(self, inputs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each sample lies within the ranges: `(...,)`."""
        array = checked_inputs(inputs, self.input_names)
        return np.asarray(self._box.inside(array) & np.isfinite(array).all(axis=-1))

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Give the reference, the hash of the module's file, the names and the envelope."""
        if self.reference is None or self.file is None:
            raise ModelError(
                "a steady-state function without a module cannot be stored in a bundle",
                hint="Load it as module:function",
            )
        meta = {
            "reference": self.reference,
            "file": self.file,
            "sha256": _sha256(Path(self.file)),
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
        }
        return meta, {"low": self._box.low, "high": self._box.high}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Import the function again, but only from a file with the stored hash.

        Raises `ModelError` if the module is missing or was changed; a changed one is not run.
        """
        what = "steady-state function"
        reference = str(stored(meta, "reference", what))
        names = (stored(meta, "input_names", what), stored(meta, "output_names", what))
        module, name = _split(reference)
        former = Path(stored(meta, "file", what))
        file = _find(module, former.parent)
        if file is None:
            raise ModelError(
                f"the steady-state model '{reference}' of this bundle is not installed",
                hint=f"Put {former.name} into {former.parent}, or install it",
            )
        if _sha256(file) != stored(meta, "sha256", what):
            raise ModelError(
                f"the steady-state model '{reference}' is not the one the bundle was trained on",
                file=file,
                hint="Restore the former file, or train anew",
            )
        ranges = _ranges(names[0], stored(arrays, "low", what), stored(arrays, "high", what))
        function = _function(_import(module, file), name, reference)
        return cls(function, names, ranges, reference, str(file))


def _ranges(names: Sequence[str], low: Floats, high: Floats) -> Ranges:
    pairs = zip(low.tolist(), high.tolist(), strict=True)
    return dict(zip(names, pairs, strict=True))


def _split(reference: str) -> tuple[str, str]:
    module, colon, name = reference.partition(":")
    if not (colon and name.isidentifier() and all(map(str.isidentifier, module.split(".")))):
        raise ConfigError(
            f"steady-state model '{reference}' is no reference to a function",
            hint="Write it as module:function",
        )
    return module, name


def _find(module: str, folder: Path) -> Path | None:
    """Find the module's file, on the import path or in `folder`, without running it."""
    installed = _installed(module)
    if installed is not None:
        return installed
    local = folder.joinpath(*module.split(".")).with_suffix(".py")
    return local.resolve() if local.is_file() else None


def _installed(module: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(module)
    except (ModuleNotFoundError, ValueError):
        return None
    if spec is None or spec.origin is None or not Path(spec.origin).is_file():
        return None
    return Path(spec.origin).resolve()


def _import(module: str, file: Path) -> ModuleType:
    if _installed(module) == file:
        return importlib.import_module(module)
    # A name of its own, so that it hides no module and a changed file is not the former one.
    own = f"_narxcal_{_sha256(file)[:12]}_{module.replace('.', '_')}"
    if own in sys.modules:
        return sys.modules[own]
    spec = importlib.util.spec_from_file_location(own, file)
    if spec is None or spec.loader is None:
        raise ConfigError("the module cannot be imported", file=file)
    sys.modules[own] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(sys.modules[own])
    except (ImportError, SyntaxError) as error:
        del sys.modules[own]
        raise ConfigError(f"the module cannot be imported: {error}", file=file) from error
    return sys.modules[own]


def _function(module: ModuleType, name: str, reference: str) -> Function:
    found = vars(module).get(name)
    if not callable(found):
        home = reference.partition(":")[0]
        raise ConfigError(
            f"steady-state model '{reference}': module '{home}' has no function '{name}'"
        )
    function: Function = found
    return function


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
