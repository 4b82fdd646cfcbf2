"""Linear state-space models in discrete time, and coordinates in which they are interpolated.

    x_k+1 = A x_k + B u_k,   y_k = C x_k + D u_k

Fits of two records come in arbitrary bases (T^-1 A T), so their entries cannot be interpolated as
they are. Three forms fix the basis:

| form | coordinates | between two stable models |
|---|---|---|
| modal (default) | per section of 1 or 2 poles: atanh of reflection coefficients, gain | stable |
| canonical | characteristic polynomial, first Markov parameters (observer form) | stable to n = 2 |
| output | A, B with C = I (order equal to the number of outputs): the paper's | not always |

A section 1 + c_1/z + c_2/z^2 has reflection coefficients k_2 = c_2 and k_1 = c_1/(1 + c_2), and is
stable where both lie in -1 .. 1. atanh maps this to the whole plane; for one pole exp(-dt/tau) it
is ln(tau) but for a constant, so that interpolating it interpolates the logarithm of the pole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from narxcal.output_error.blocks import recursion
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError

ComplexArray = NDArray[np.complex128]
Form = Literal["modal", "canonical", "output"]
_EDGE = 1.0 - 1e-9  # of a reflection coefficient, whose atanh is finite


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A (n, n), B (n, inputs), C (outputs, n), D (outputs, inputs), sampled every `dt_s`."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    dt_s: float

    def __post_init__(self) -> None:
        n, m, p = len(self.A), self.B.shape[1], len(self.C)
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
        wrong = {
            k: getattr(self, k).shape for k, v in shapes.items() if getattr(self, k).shape != v
        }
        if wrong:
            raise ConfigError(f"state space of order {n}: expected {shapes}, found {wrong}")

    @property
    def order(self) -> int:
        return len(self.A)

    @property
    def poles(self) -> ComplexArray:
        """Discrete poles (n,), slowest (largest modulus) first."""
        found = np.linalg.eigvals(self.A).astype(np.complex128)
        return found[np.argsort(-np.abs(found), kind="stable")]

    @property
    def stable(self) -> bool:
        return bool(np.all(np.abs(self.poles) < 1.0))

    @property
    def time_constants_s(self) -> FloatArray:
        """-dt/ln|z| of every pole (n,), slowest first."""
        with np.errstate(divide="ignore"):
            return np.asarray(-self.dt_s / np.log(np.abs(self.poles)))

    @property
    def gain(self) -> FloatArray:
        """Static gain (outputs, inputs)."""
        eye = np.eye(self.order)
        return np.asarray(self.C @ np.linalg.solve(eye - self.A, self.B) + self.D)

    def simulate(self, u: FloatArray, x0: FloatArray | None = None) -> FloatArray:
        """Free run: outputs (time, outputs) for inputs (time, inputs) from state x0 (n,)."""
        if u.ndim != 2 or u.shape[1] != self.B.shape[1]:
            raise DataError(f"expected inputs (time, {self.B.shape[1]}), found {u.shape}")
        start = np.zeros(self.order) if x0 is None else x0
        states = recursion(self.A, (u @ self.B.T)[:-1], start)
        return np.asarray(states @ self.C.T + u @ self.D.T)

    def transformed(self, T: FloatArray) -> StateSpace:
        """Same model with states x = T z."""
        inverse = np.linalg.inv(T)
        return StateSpace(inverse @ self.A @ T, inverse @ self.B, self.C @ T, self.D, self.dt_s)

    def markov(self, count: int) -> FloatArray:
        """Impulse response C A^k B, k = 0 .. count-1: (count, outputs, inputs)."""
        found, right = [], self.B
        for _ in range(count):
            found.append(self.C @ right)
            right = self.A @ right
        return np.array(found)

    def to_dict(self) -> dict[str, Any]:
        return {k: getattr(self, k).tolist() for k in "ABCD"} | {"dt_s": self.dt_s}

    @classmethod
    def from_dict(cls, stored: dict[str, Any]) -> StateSpace:
        A, B, C, D = (np.array(stored[k], dtype=np.float64) for k in "ABCD")
        return cls(A, B, C, D, float(stored["dt_s"]))


def coordinates(model: StateSpace, form: Form = "modal") -> FloatArray:
    """Coordinates of `model` in a fixed basis, to be interpolated; `from_coordinates` is back."""
    if form == "output":
        return _output_coordinates(model)
    n, shape = model.order, (model.order, *model.D.shape)
    if form == "canonical":
        polynomial = np.real(np.poly(model.poles))[1:]
        return np.concatenate([polynomial, model.markov(n).ravel(), model.D.ravel()])
    sections = _sections(model.poles)
    atanh = [np.arctanh(np.clip(k, -_EDGE, _EDGE)) for c in sections for k in _reflections(c)]
    residues = _residues(model, sections).reshape(shape)
    return np.concatenate([np.array(atanh), residues.ravel(), model.D.ravel()])


def from_coordinates(
    values: FloatArray, sizes: tuple[int, int, int], dt_s: float, form: Form = "modal"
) -> StateSpace:
    """Model of `sizes` (order, outputs, inputs) at the coordinates of `coordinates`."""
    n, p, m = sizes
    if form == "output":
        return StateSpace(
            values[: n * n].reshape(n, n), values[n * n :].reshape(n, m), np.eye(n),
            np.zeros((n, m)), dt_s,
        )  # fmt: skip
    head, body = values[:n], values[n : n + n * p * m].reshape(n, p, m)
    D = values[n + n * p * m :].reshape(p, m)
    if form == "canonical":
        return _observer(head, body, D, dt_s)
    tanh, parts, at = np.tanh(head), [], 0
    for size in [2] * (n // 2) + [1] * (n % 2):  # slowest poles first
        denominator = _denominator(tanh[at : at + size])
        markov = _markov_of_section(denominator, body[at : at + size])
        parts.append(_observer(denominator, markov, np.zeros((p, m)), dt_s))
        at += size
    A = block_diag(*(part.A for part in parts))
    B = np.concatenate([part.B for part in parts])
    return StateSpace(A, B, np.concatenate([part.C for part in parts], axis=1), D, dt_s)


def _output_coordinates(model: StateSpace) -> FloatArray:
    p, n = model.C.shape
    if p != n or np.linalg.cond(model.C) > 1e12 or np.any(np.abs(model.D) > 0.0):
        raise ModelError(
            f"the form with C = I needs as many independent outputs as states and D = 0, found "
            f"{p} outputs and order {n}"
        )
    same = model.transformed(np.asarray(np.linalg.inv(model.C), dtype=np.float64))
    return np.concatenate([same.A.ravel(), same.B.ravel()])


def _sections(poles: ComplexArray) -> list[FloatArray]:
    """Denominators [c_1, (c_2)] of sections of poles paired by speed.

    Complex pairs stay together; real poles pair with the next slower or faster real one.
    """
    real = [z.real for z in poles if abs(z.imag) <= 1e-9 * abs(z)]
    pairs = [(z, z.conjugate()) for z in poles if z.imag > 1e-9 * abs(z)]
    pairs += [(complex(a), complex(b)) for a, b in zip(real[::2], real[1::2], strict=False)]
    pairs.sort(key=lambda pair: -max(abs(pair[0]), abs(pair[1])))
    found = [np.array([-(a + b).real, (a * b).real]) for a, b in pairs]
    return [*found, np.array([-real[-1]])] if len(real) % 2 else found


def _reflections(c: FloatArray) -> list[float]:
    return [c[0]] if len(c) == 1 else [c[0] / (1.0 + c[1]), c[1]]


def _denominator(k: FloatArray) -> FloatArray:
    return k if len(k) == 1 else np.array([k[0] * (1.0 + k[1]), k[1]])


def _residues(model: StateSpace, sections: list[FloatArray]) -> FloatArray:
    """Per section and transfer path its static gain and, of two poles, its first Markov parameter.

    They are the solution of a linear system: the Markov parameters of the sections sum to those
    of the model. (n, outputs * inputs).
    """
    n = model.order
    columns = []
    for c in sections:
        for unit in np.eye(len(c)):
            markov = _markov_of_section(c, unit[:, np.newaxis, np.newaxis])
            columns.append(_observer(c, markov, np.zeros((1, 1)), 1.0).markov(2 * n).ravel())
    target = model.markov(2 * n).reshape(2 * n, -1)
    return np.asarray(np.linalg.lstsq(np.array(columns).T, target, rcond=None)[0])


def _markov_of_section(c: FloatArray, body: FloatArray) -> FloatArray:
    """First Markov parameters of a section from its gain g and, of two poles, h_0."""
    gain, total = body[0], 1.0 + float(c.sum())
    if len(c) == 1:
        return np.asarray(gain[np.newaxis] * total)
    # (h_0 + h_1 + c_1 h_0) / (1 + c_1 + c_2) = g
    return np.stack([body[1], gain * total - body[1] * (1.0 + c[0])])


def _observer(c: FloatArray, markov: FloatArray, D: FloatArray, dt_s: float) -> StateSpace:
    """Observer form of sum_k h_k z^-k with denominator 1 + c_1/z + ..: one block per output."""
    n, p, m = markov.shape
    numerator = np.array(
        [markov[i] + sum((c[j] * markov[i - 1 - j] for j in range(i)), np.zeros((p, m)))
         for i in range(n)]
    )  # fmt: skip
    if p <= m:
        A = np.diag(np.ones(n - 1), 1)
        A[:, 0] = -c
        blocks = block_diag(*([A] * p))
        B = numerator.transpose(1, 0, 2).reshape(p * n, m)
        C: FloatArray = np.kron(np.eye(p), np.eye(1, n)).astype(np.float64)
    else:
        A = np.diag(np.ones(n - 1), -1)
        A[0] = -c
        blocks = block_diag(*([A] * m))
        B = np.kron(np.eye(m), np.eye(1, n).T)
        C = numerator.transpose(1, 2, 0).reshape(p, m * n)
    return StateSpace(blocks, B, C, D, dt_s)
