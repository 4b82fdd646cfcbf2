"""Blocks of the engine with its controls: linear systems, play, governor; exact discretisation.

Every block is usable alone (`lag(1.36, 0.05).respond(N_L, 0.05)`) and in a chain
(`rotors(...).then(sensors)`). Source: DeHoff et al., Identification of a STOL propulsion plant
model from flight data, equations 1, 2 and 9 and figure 4. Its block diagram is lost; forms that the
text does not print are marked as reconstructions.

| symbol | meaning | unit |
|---|---|---|
| N_H, N_L | deviation of compressor and fan speed from equilibrium | % |
| W_F, W_m | fuel flow and what the flowmeter shows of it, deviations | fuel unit |
| P_D, P_E | duct and tailpipe pressure, deviations | % |
| tau_H, tau_L | collective and differential time constant | s |
| C_FH, C_HL | steady N_H per W_F, steady N_L per N_H | % per unit, % per % |
| alpha | share of N_L that follows fuel flow directly | - |
| K_AF | fuel flow per governor speed error | unit per % |
| C_FB | 1/C_FB: fuel flow per N_H at constant orifice area (pressure-drop governor) | % per unit |
| zeta, omega | damping ratio and natural frequency of the flowmeter | -, rad/s |

Sensitivities by complex step: every block accepts complex parameters, and comparisons (`play`,
signs) use real parts only. With a step of 1e-20 the imaginary part is then the exact
derivative almost everywhere, as in forward-mode automatic differentiation (Martins, Sturdza,
Alonso, ACM TOMS 29(3), 2003); smoothing of play is not needed. At a change of contact the
derivative is one-sided.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag, expm

from narxcal.support.compiled import compiled
from narxcal.support.errors import ModelError

Values = NDArray[Any]  # float64, or complex128 while sensitivities are computed
Hold = Literal["zoh", "foh"]


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """x' = A x + B u, y = C x + D u in continuous time; without states it is the gain D.

    Shapes: A (n, n), B (n, m), C (p, n), D (p, m).
    """

    A: Values
    B: Values
    C: Values
    D: Values

    @staticmethod
    def gain(D: ArrayLike) -> LinearSystem:
        d = np.atleast_2d(np.asarray(D))
        outputs, inputs = d.shape
        return LinearSystem(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0)), d)

    def then(self, after: LinearSystem) -> LinearSystem:
        """Connect in series: the outputs of this system are the inputs of `after`."""
        n, m = len(self.A), len(after.A)
        return LinearSystem(
            np.block([[self.A, np.zeros((n, m))], [after.B @ self.C, after.A]]),
            np.vstack([self.B, after.B @ self.D]),
            np.hstack([after.D @ self.C, after.C]),
            after.D @ self.D,
        )

    def beside(self, other: LinearSystem) -> LinearSystem:
        """Connect in parallel: the same inputs, the outputs of both."""
        return LinearSystem(
            block_diag(self.A, other.A),
            np.vstack([self.B, other.B]),
            block_diag(self.C, other.C),
            np.vstack([self.D, other.D]),
        )

    def feedback(self, K: ArrayLike) -> LinearSystem:
        """Close the loop u = r + K y, K (m, p); the result has the input r.

        Only outputs without direct feedthrough may be fed back (K D = 0).
        """
        gains = np.atleast_2d(np.asarray(K))
        back = gains @ self.C
        return LinearSystem(self.A + self.B @ back, self.B, self.C + self.D @ back, self.D)

    def lead(self, tau_s: complex) -> LinearSystem:
        """Give the system behind a lead: u + tau u' instead of u; needs D = 0.

        With z = x - tau B u the derivative of u is gone: z' = A z + (B + tau A B) u.
        """
        return LinearSystem(
            self.A, self.B + tau_s * (self.A @ self.B), self.C, tau_s * (self.C @ self.B)
        )

    def equilibrium(self, u: ArrayLike) -> Values:
        """State (n,) at which a constant input (m,) leaves the system; `ModelError` if none."""
        try:
            return np.asarray(np.linalg.solve(self.A, -self.B @ np.asarray(u)))
        except np.linalg.LinAlgError:
            raise ModelError(
                "the system integrates its input and has no equilibrium",
                hint="Give the initial state",
            ) from None

    def discretise(self, dt_s: float, hold: Hold = "foh") -> tuple[Values, Values, Values]:
        """Give (Phi, F, E) of x(k+1) = Phi x(k) + F u(k) + E u(k+1), exact for the given hold.

        Zero-order hold (u constant between samples, E = 0) for commands that step; first-order
        hold (u linear between samples) for measured, smooth inputs. Both from one matrix
        exponential (van Loan), so equal time constants need no special case.
        """
        n, m = self.B.shape
        steps = 1 if hold == "zoh" else 2
        block = np.zeros((n + steps * m,) * 2, dtype=np.result_type(self.A, self.B))
        block[:n, :n], block[:n, n : n + m] = self.A * dt_s, self.B * dt_s
        if hold == "foh":
            block[n : n + m, n + m :] = np.eye(m)
        exponential = expm(block)
        phi, g1 = exponential[:n, :n], exponential[:n, n : n + m]
        g2 = exponential[:n, n + m :] if hold == "foh" else np.zeros_like(g1)
        return phi, g1 - g2, g2

    def respond(
        self, u: ArrayLike, dt_s: float, hold: Hold = "foh", start: ArrayLike | None = None
    ) -> Values:
        """Outputs (time, p) for inputs (time, m) or (time,) from the state `start`.

        Without `start` the run begins in the equilibrium of the first input.
        """
        inputs = np.asarray(u)
        inputs = inputs[:, None] if inputs.ndim == 1 else inputs
        x0 = self.equilibrium(inputs[0]) if start is None else np.asarray(start)
        phi, f, e = self.discretise(dt_s, hold)
        drive = inputs[:-1] @ f.T + inputs[1:] @ e.T
        return np.asarray(recursion(phi, drive, x0) @ self.C.T + inputs @ self.D.T)


def recursion(phi: Values, drive: Values, start: Values) -> Values:
    """States (time, n) of x(k+1) = Phi x(k) + drive(k), with drive (time - 1, n)."""
    kind = np.result_type(phi, drive, start, np.float64)
    given = (np.ascontiguousarray(one, dtype=kind) for one in (phi, drive, start))
    return _recursion(*given)


def as_complex(values: ArrayLike) -> Values:
    return np.ascontiguousarray(values, dtype=np.complex128)


def _as_given(result: Values, *given: Any) -> Values:
    return result if any(np.iscomplexobj(each) for each in given) else result.real.copy()


@compiled
def _recursion(phi: Values, drive: Values, start: Values) -> Values:
    steps, n = drive.shape
    states = np.empty((steps + 1, n), dtype=drive.dtype)
    states[0] = start
    for k in range(steps):
        for i in range(n):
            total = drive[k, i]
            for j in range(n):
                total += phi[i, j] * states[k, j]
            states[k + 1, i] = total
    return states


def lag(gain: complex, tau_s: complex) -> LinearSystem:
    """First-order lag tau y' = -y + gain u; tau = 0 drops the state: y = gain u (equation 2)."""
    if tau_s == 0:
        return LinearSystem.gain([[gain]])
    return LinearSystem(
        np.array([[-1.0 / tau_s]]), np.array([[gain / tau_s]]), np.ones((1, 1)), np.zeros((1, 1))
    )


@compiled
def lag_step(y: complex, ends: tuple[complex, complex], steps: complex) -> complex:
    """Output of a lag of time constant `steps` * dt, one dt later, behind a straight line."""
    behind = steps * (ends[1] - ends[0])
    return complex(ends[1] - behind + (y - ends[0] + behind) * np.exp(-1.0 / steps))


def flowmeter(zeta: complex, omega: complex, K_SF: complex = 1.0) -> LinearSystem:
    """Lightly damped flowmeter W_m'' + 2 zeta omega W_m' + omega^2 W_m = omega^2 K_SF W_F."""
    square = omega * omega
    return LinearSystem(
        np.array([[0.0, 1.0], [-square, -2.0 * zeta * omega]]),
        np.array([[0.0], [square * K_SF]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )


@dataclass(frozen=True, kw_only=True)
class Rotors:
    """Two spools, W_F -> (N_H, N_L), equation 1 with its rows divided by the time constants.

        tau_H N_H' = -N_H + C_FH W_F
        tau_L N_L' = -N_L + C_HL ((1 - alpha) N_H + alpha C_FH W_F)

    Reconstruction: as printed, the right-hand sides but for the first terms are not divided by tau;
    then steady gains depend on the time constants, which contradicts Table 4.
    """

    tau_H: complex
    tau_L: complex
    C_FH: complex
    C_HL: complex
    alpha: complex

    def system(self) -> LinearSystem:
        A = [
            [-1.0 / self.tau_H, 0.0],
            [self.C_HL * (1.0 - self.alpha) / self.tau_L, -1.0 / self.tau_L],
        ]
        B = [[self.C_FH / self.tau_H], [self.alpha * self.C_FH * self.C_HL / self.tau_L]]
        return LinearSystem(np.array(A), np.array(B), np.eye(2), np.zeros((2, 1)))


def play(
    u: ArrayLike,
    half_width: complex,
    proportional: complex = 0.0,
    start: complex | None = None,
) -> Values:
    """Play (backlash) of a linkage, u (time,) -> w (time,).

        w(k) = max(u(k) - r(k), min(u(k) + r(k), w(k-1))),   r = half_width + proportional |u|

    `start` is w before the first sample; without it w begins at u(0). dw/dr is -1 on rising
    contact, +1 on falling contact, and carried over between.
    """
    inputs = np.asarray(u)
    r = half_width + proportional * inputs * np.sign(inputs.real)
    first = inputs[0] if start is None else start
    result = _play(as_complex(inputs - r), as_complex(inputs + r), complex(first))
    return _as_given(result, inputs, r, first)


@compiled
def _between(value: complex, low: complex, high: complex) -> complex:
    """Give max(low, min(high, value)) by real parts."""
    if value.real > high.real:
        value = high
    return low if value.real < low.real else value


@compiled
def _play(low: Values, high: Values, start: complex) -> Values:
    result = np.empty_like(low)
    value = start
    for k in range(len(low)):
        value = _between(value, low[k], high[k])
        result[k] = value
    return result


@dataclass(frozen=True, kw_only=True)
class Governor:
    """Speed governor: W_F = K_AF (N_c - N_H) + N_H/C_FB + W_F0.

    Reconstruction: the law is the slope of equation 3, W_F = K_p (g1 + g2 X_c - g3 N_H^2) N_H,
    whose last factor is the pressure-drop governor's positive feedback N_H/C_FB. In percent of full
    flow the slope W_0/N_0 of equation 3 would be 1, not 1/C_FB = 8.8: the unit of fuel flow is not
    stated by the paper; dynamics do not depend on it. Hysteresis of the governor, a quadratic
    orifice and its saturation, of which the paper has no significant estimate, are left out.
    """

    K_AF: complex
    C_FB: complex
    W_F0: complex = 0.0

    def engine(self, rotors: LinearSystem) -> LinearSystem:
        """Rotors with the positive feedback, W_F - N_H/C_FB -> (N_H, N_L, W_F)."""
        with_fuel = rotors.beside(LinearSystem.gain([[1.0]]))
        return with_fuel.feedback([[1.0 / self.C_FB, 0.0, 0.0]])

    def closed_loop(self, plant: LinearSystem) -> LinearSystem:
        """Close the law around `plant`; its input is K_AF N_c + W_F0."""
        row = np.zeros((1, len(plant.C)))
        row[0, 0] = 1.0
        return plant.feedback(-self.K_AF * row)

    def respond(
        self, plant: LinearSystem, N_c: ArrayLike, dt_s: float, shift: ArrayLike = 0.0
    ) -> Values:
        """Outputs (time, p) of `plant`, the first of them N_H, under the governor.

        Starts `shift` (n,) away from the equilibrium of N_c(0); N_c is linear between samples.
        """
        closed = self.closed_loop(plant)
        drive = self.K_AF * np.asarray(N_c) + self.W_F0
        start = closed.equilibrium(drive[:1]) + np.asarray(shift)
        return closed.respond(drive, dt_s, start=start)
