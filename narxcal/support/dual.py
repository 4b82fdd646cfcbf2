"""Dual numbers for compiled code: a value that carries its slopes (forward-mode differentiation).

A compiled function written for floats, with `get` and `put` where it reads and writes arrays,
works for dual numbers too and then gives exact derivatives:

    arrays of floats (n, ...)        get(x, i) is a float        put(x, i, value)
    arrays (n, ..., 1 + WIDTH)       get(x, i) is a dual: the value, then its slopes by WIDTH
                                     parameters; see `seeded`

Rule of each operation f(a, b), the chain rule: slopes = df/da slopes(a) + df/db slopes(b).
Supported are + - * / unary - < > abs, `math.exp`, `math.sqrt` and `clip`; a float among duals is a
constant. Slopes are one LLVM vector, so that an operation on all of them is a machine instruction
or two. Source: A. Griewank and A. Walther, *Evaluating Derivatives*, SIAM 2008, section 3.1.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    make_attribute_wrapper,
    models,
    overload,
    register_model,
)

from narxcal.support.arrays import FloatArray, IntArray

WIDTH: Final = 32  # slopes of a dual number; 16 take 1.4 times as long per slope, 8 take 2 times
_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)
_BROADCAST = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), None)


class _Slopes(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"slopes{WIDTH}")


class _Dual(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"dual{WIDTH}")


_SLOPES, _DUAL = _Slopes(), _Dual()
_intrinsic: Any = intrinsic  # the compiler passes its context itself
_overload = partial(overload, strict=False)  # annotations may differ


@register_model(_Slopes)
class _SlopesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


@register_model(_Dual)
class _DualModel(models.StructModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, [("value", types.float64), ("slopes", _SLOPES)])


make_attribute_wrapper(_Dual, "value", "value")
_dual = cgutils.create_struct_proxy(_DUAL)


@_intrinsic
def _chained(_: Any, value: Any, by_a: Any, a: Any, by_b: Any, b: Any) -> Any:  # noqa: ARG001
    """The dual number of `value` whose slopes are `by_a` times those of a plus `by_b` times b's."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        total = ir.Constant(_VECTOR, None)
        for k in (1, 3):
            if signature.args[k + 1] != _DUAL:  # a constant
                continue
            slopes = _dual(context, builder, value=given[k + 1]).slopes
            empty = ir.Constant(_VECTOR, ir.Undefined)
            factor = builder.insert_element(empty, given[k], ir.IntType(32)(0))
            factor = builder.shuffle_vector(factor, empty, _BROADCAST)
            total = builder.fadd(total, builder.fmul(factor, slopes))
        made = _dual(context, builder)
        made.value, made.slopes = given[0], total
        return made._getvalue()  # noqa: SLF001 (numba's own name)

    number = types.float64
    return _DUAL(number, number, a, number, b), build


def _addresses(context: Any, builder: Any, kind: Any, row: Any) -> tuple[Any, Any]:
    """Where the value and the slopes of an array's row (1 + WIDTH,) are."""
    data = context.make_array(kind)(context, builder, row).data
    slopes = builder.gep(data, [ir.IntType(64)(1)])
    return data, builder.bitcast(slopes, _VECTOR.as_pointer())


@_intrinsic
def _loaded(_: Any, row: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        value, slopes = _addresses(context, builder, signature.args[0], given[0])
        made = _dual(context, builder)
        made.value, made.slopes = builder.load(value), builder.load(slopes, align=8)
        return made._getvalue()  # noqa: SLF001

    return _DUAL(row), build


@_intrinsic
def _stored(_: Any, row: Any, number: Any) -> Any:
    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        value, slopes = _addresses(context, builder, signature.args[0], given[0])
        number = _dual(context, builder, value=given[1])
        builder.store(number.value, value)
        builder.store(number.slopes, slopes, align=8)
        return context.get_dummy_value()

    return types.void(row, number), build


def seeded(values: FloatArray, free: IntArray) -> FloatArray:
    """Dual numbers (n, 1 + WIDTH) of `values` (n,); slope j is that by parameter `free[j]`."""
    numbers = np.zeros((len(values), 1 + WIDTH))
    numbers[:, 0] = values
    numbers[free, 1 + np.arange(len(free))] = 1.0
    return numbers


def get(x: FloatArray, i: int | tuple[int, ...]) -> float:
    """Number `i` of an array of floats or of dual numbers."""
    value: float = x[i]
    return value


def put(x: FloatArray, i: int | tuple[int, ...], number: float) -> None:
    """Make `number` the number `i` of an array of floats or of dual numbers."""
    x[i] = number


def clip(x: float, low: float, high: float) -> float:
    """`x` within the bounds; beyond them its slopes are zero."""
    return min(max(x, low), high)


def _of_floats(x: Any, i: Any) -> bool:
    return bool(x.ndim == (len(i) if isinstance(i, types.BaseTuple) else 1))


@_overload(get)
def _get(x: Any, i: Any) -> Any:
    return (lambda x, i: x[i]) if _of_floats(x, i) else (lambda x, i: _loaded(x[i]))


@_overload(put)
def _put(x: Any, i: Any, number: Any) -> Any:
    def put_float(x: Any, i: Any, number: Any) -> None:
        x[i] = number

    def put_constant(x: Any, i: Any, number: Any) -> None:
        x[i] = 0.0
        x[i][0] = number

    def put_dual(x: Any, i: Any, number: Any) -> None:
        _stored(x[i], number)

    if _of_floats(x, i):
        return put_float
    return put_dual if number == _DUAL else put_constant


def _value(x: Any) -> Any:
    return x


@_overload(_value)
def _value_of(x: Any) -> Any:
    return (lambda x: x.value) if x == _DUAL else (lambda x: x)


def _binary(operation: Any, rule: Callable[[Any, Any], tuple[Any, Any, Any]]) -> None:
    """Define an operation by a rule that gives f(a, b), df/da and df/db."""
    rule = njit(error_model="numpy")(rule)

    @_overload(operation)
    def of(a: Any, b: Any) -> Any:
        def apply(a: Any, b: Any) -> Any:
            value, by_a, by_b = rule(_value(a), _value(b))
            return _chained(value, by_a, a, by_b, b)

        return apply if _DUAL in (a, b) else None


def _unary(operation: Any, rule: Callable[[Any], tuple[Any, Any]]) -> None:
    """Define an operation by a rule that gives f(a) and df/da."""
    rule = njit(error_model="numpy")(rule)

    @_overload(operation)
    def of(a: Any) -> Any:
        def apply(a: Any) -> Any:
            value, by_a = rule(a.value)
            return _chained(value, by_a, a, 0.0, 0.0)

        return apply if a == _DUAL else None


def _comparison(operation: Any) -> None:
    @_overload(operation)
    def of(a: Any, b: Any) -> Any:
        return (lambda a, b: operation(_value(a), _value(b))) if _DUAL in (a, b) else None


def _exp(x: float) -> tuple[float, float]:
    value = math.exp(x)
    return value, value


def _sqrt(x: float) -> tuple[float, float]:
    value = math.sqrt(x)
    return value, 0.5 / value


_binary(operator.add, lambda a, b: (a + b, 1.0, 1.0))
_binary(operator.sub, lambda a, b: (a - b, 1.0, -1.0))
_binary(operator.mul, lambda a, b: (a * b, b, a))
_binary(operator.truediv, lambda a, b: (a / b, 1.0 / b, -a / (b * b)))
_unary(operator.neg, lambda a: (-a, -1.0))
_unary(abs, lambda a: (abs(a), math.copysign(1.0, a)))
_unary(math.exp, _exp)
_unary(math.sqrt, _sqrt)
_comparison(operator.lt)
_comparison(operator.gt)


@_overload(clip)
def _clip(x: Any, low: Any, high: Any) -> Any:  # noqa: ARG001 (the types of all arguments)
    def clip_dual(x: Any, low: Any, high: Any) -> Any:
        inside = 1.0 if low < x.value < high else 0.0
        return _chained(min(max(x.value, low), high), inside, x, 0.0, 0.0)

    return clip_dual if x == _DUAL else (lambda x, low, high: min(max(x, low), high))
