"""Numbers that write themselves down: an ONNX graph built by ordinary arithmetic.

A `Number` is a float64 column (batch,) or rows (batch, ...) of a graph. Functions that were written
for floats and compiled by numba are traced: `traced` rebuilds a module's functions so that they
take numbers; a branch on a number runs both ways, and `Where` joins what comes back. `run` runs
an exported graph by onnxruntime.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

OPSET = 18
BOUND = 1e-5  # of a difference between onnxruntime and `simulate`


class Graph:
    """Nodes and constants; the same operation on the same inputs is one node."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: dict[str, NDArray[Any]] = {}
        self._known: dict[Any, str] = {}

    def constant(self, value: Any, kind: type = np.float64) -> Number:
        array: NDArray[Any] = np.asarray(value, dtype=kind)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._known:
            self._known[key] = f"c{len(self.constants)}"
            self.constants[self._known[key]] = array
        return Number(self, self._known[key])

    def add(self, operation: str, *inputs: Any, **attributes: Any) -> Number:
        from onnx import helper  # noqa: PLC0415  (an extra that most installations lack)

        names = [one.name if isinstance(one, Number) else self.constant(one).name for one in inputs]
        key = (operation, tuple(names), tuple(sorted(attributes.items())))
        if key not in self._known:
            name = f"n{len(self.nodes)}"
            self.nodes.append(helper.make_node(operation, names, [name], **attributes))
            self._known[key] = name
        return Number(self, self._known[key])

    def serialized(
        self,
        inputs: Mapping[str, int],
        outputs: Mapping[str, tuple[Number, int]],
        properties: dict[str, str],
    ) -> bytes:
        """Checked model of float64 rows (batch, width): names and widths of both ends."""
        from onnx import TensorProto, checker, helper, numpy_helper  # noqa: PLC0415 -- an extra

        def described(widths: Mapping[str, int]) -> list[Any]:
            return [
                helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["batch", width])
                for name, width in widths.items()
            ]

        ends = [
            helper.make_node("Identity", [number.name], [name])
            for name, (number, _) in outputs.items()
        ]
        constants = [numpy_helper.from_array(each, name) for name, each in self.constants.items()]
        made = described({name: width for name, (_, width) in outputs.items()})
        nodes = [*self.nodes, *ends]
        graph = helper.make_graph(nodes, "engine", described(inputs), made, constants)
        opset = helper.make_opsetid("", OPSET)
        proto = helper.make_model(
            graph, opset_imports=[opset], producer_name="narxcal", ir_version=9
        )
        helper.set_model_props(proto, properties)
        checker.check_model(proto)
        return bytes(proto.SerializeToString())


def _both_sides(operation: str) -> tuple[Callable[..., Number], Callable[..., Number]]:
    """An operator with the number on its left, and on its right."""
    return (
        lambda number, other: number.to(operation, other),
        lambda number, other: number.graph.add(operation, other, number),
    )


class Number:
    """A value in a graph."""

    # Arrays leave arithmetic to the number on the other side.
    __array_ufunc__ = None

    def __init__(self, graph: Graph, name: str) -> None:
        self.graph, self.name = graph, name

    def to(self, operation: str, *others: Any, **attributes: Any) -> Number:
        return self.graph.add(operation, self, *others, **attributes)

    __add__, __radd__ = _both_sides("Add")
    __sub__, __rsub__ = _both_sides("Sub")
    __mul__, __rmul__ = _both_sides("Mul")
    __truediv__, __rtruediv__ = _both_sides("Div")
    __gt__, __lt__ = _both_sides("Greater")[0], _both_sides("Less")[0]

    def __neg__(self) -> Number:
        return self.to("Neg")

    def __abs__(self) -> Number:
        return self.to("Abs")

    def __bool__(self) -> bool:
        if not _PATHS:
            raise ModelError("a branch on a number stands outside of a function that is traced")
        return _PATHS[-1].decide(self)

    def column(self, k: int) -> Number:
        return self.to("Gather", self.graph.constant(k, np.int64), axis=1)


def clip(x: Any, low: float, high: float) -> Any:
    if not isinstance(x, Number):
        return min(max(x, low), high)
    x = x.to("Max", low) if low > -math.inf else x
    return x.to("Min", high) if high < math.inf else x


def where(condition: Number, yes: Any, no: Any) -> Any:
    """Choose between two values, or tuples of them."""
    if isinstance(yes, tuple):
        parts = [where(condition, a, b) for a, b in zip(yes, no, strict=True)]
        return type(yes)(*parts) if hasattr(yes, "_fields") else tuple(parts)
    if yes is no or (isinstance(yes, Number) and isinstance(no, Number) and yes.name == no.name):
        return yes
    return condition.to("Where", yes, no)


class _Path:
    """Decisions on a way through a function: those given, then yes to every further one."""

    def __init__(self, given: list[bool]) -> None:
        self.given, self.conditions = given, list[Number]()

    def decide(self, condition: Number) -> bool:
        self.conditions.append(condition)
        place = len(self.conditions) - 1
        return self.given[place] if place < len(self.given) else True


_PATHS: list[_Path] = []


def _both_ways(function: Callable[..., Any]) -> Callable[..., Any]:
    def ended(given: list[bool], arguments: tuple[Any, ...]) -> Any:
        path = _Path(given)
        _PATHS.append(path)
        try:
            value = function(*arguments)
        finally:
            _PATHS.pop()
        further = range(len(given), len(path.conditions))
        if value is None and further:
            raise ModelError(f"'{function.__name__}' changes an array behind a branch")
        for place in reversed(further):
            turned = [*given, *[True] * (place - len(given)), False]
            value = where(path.conditions[place], value, ended(turned, arguments))
        return value

    return lambda *arguments: ended([], arguments)


def _of_both(name: str) -> Callable[[Any], Any]:
    def function(x: Any) -> Any:
        return x.to(name.capitalize()) if isinstance(x, Number) else getattr(math, name)(x)

    return function


_MATHS = SimpleNamespace(
    inf=math.inf, ceil=math.ceil, **{name: _of_both(name) for name in ("exp", "sqrt", "log")}
)


def traced(module: ModuleType, made: dict[str, dict[str, Any]] | None = None) -> Mapping[str, Any]:
    """Names of a module, its compiled functions taking numbers in the place of floats."""
    made = {} if made is None else made
    if module.__name__ in made:
        return made[module.__name__]
    names = made[module.__name__] = dict(vars(module))
    names |= {"math": _MATHS, "clip": clip}
    for name, value in vars(module).items():
        plain = getattr(value, "py_func", None)
        if plain is None or name == "clip":
            continue
        home = names
        if plain.__module__ != module.__name__:
            home = dict(traced(sys.modules[plain.__module__], made))
            names[name] = made[plain.__module__][plain.__name__]
            continue
        names[name] = _both_ways(FunctionType(plain.__code__, home, plain.__name__))
    return names


# --- a written graph ---


def runtime() -> Any:
    """The module onnxruntime, None where it is not installed."""
    try:
        import onnxruntime  # noqa: PLC0415  (no extra of narxcal has it)
    except ImportError:
        return None
    return onnxruntime


def run(file: Path, inputs: Sequence[FloatArray]) -> list[FloatArray]:
    """Free runs (time, n_out) from equilibrium over inputs (time, n_in), all as one batch."""
    ort = runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    width, longest = session.get_inputs()[0].shape[1], max(map(len, inputs))
    state, rows = np.full((len(inputs), width), np.nan), []
    for k in range(longest):
        given = np.array([one[min(k, len(one) - 1)] for one in inputs])
        state, output = session.run(["next_state", "output"], {"state": state, "input": given})
        rows.append(output)
    found = np.array(rows)
    return [found[: len(one), k] for k, one in enumerate(inputs)]
