"""Compiled closed-loop kernels of the NARX network, and nothing else.

The network (papers/narx calibration, equations 2 and 3, plus a linear path) is

    y(k) = clip( b2 + A phi(k) + W2 tanh(b1 + W1 phi(k)),  low, high )
    phi(k) = [ y(k-1) .. y(k-n),  u(k-d1) .. u(k-dm) ]

An *anchored* network subtracts its own value at rest, `W2 tanh(b1 + W1 rest(k)) + A rest(k)`,
where `rest` is phi with the feedback and all moving inputs set to zero; it has no b2.

All that depends on the inputs alone is one matrix product, done beforehand:
`drive_hidden = b1 + W1u phi_u` and `drive_linear = b2 + Au phi_u`, less the value at rest. Only
the feedback part, `W1y` and `Ay`, is left in the recursion. The PyTorch module in `narx.network`
is the slow exact twin of these functions and their test.

Several windows are run as one: `restarts` is (positions (n,), histories (n, m)), the steps at
which a window begins and the outputs just before it.

Loops over the hidden units are innermost and contiguous, so that they run in the processor's
vector registers: W1y is stored transposed, and tanh is evaluated for all units at once.

Shapes: T steps, o outputs, h hidden units, m = lags * o feedback entries (newest lag first),
f = m + input taps features, P parameters in the order W1 (h, f), b1 (h), W2 (o, h), b2 (o),
A (o, f), each flattened by rows.
"""

from __future__ import annotations

import math

import numpy as np

from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

Run = tuple[FloatArray, FloatArray, FloatArray]
Feedback = tuple[FloatArray, FloatArray, FloatArray]

_LOG2_E = 1.4426950408889634
# ln 2 in two parts, the first with trailing zeros, so that k ln 2 is exact to the last digit.
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROUND = 1.5 * 2.0**52  # x + this has the nearest integer to x in its lowest bits
_EXPONENT, _BIAS = 52, 1023 << 52  # where a double keeps the power of two, and that of 1
_FLAT = 20.0  # tanh is 1 to the last digit from here on
# 1 / n! for n = 2 to 13; with |r| <= ln 2 / 2 the first term left out is 4e-18 of the value.
_F2, _F3, _F4, _F5, _F6, _F7, _F8, _F9, _F10, _F11, _F12, _F13 = (
    1.0 / math.factorial(n) for n in range(2, 14)
)


@compiled  # exact: with its sums reordered, x + _ROUND - _ROUND would be x
def tanh_of(x: FloatArray, found: FloatArray, power: FloatArray) -> None:
    """Write tanh(x) to `found`, to 5e-16 of its value; `power` is scratch; all are (n,).

    With d = 2 x = k ln 2 + r, expm1(d) = 2^k expm1(r) + (2^k - 1), expm1(r) by its power series,
    and tanh(x) = expm1(d) / (expm1(d) + 2). No branch and no call, so that the loops are
    vectorised: 10 times faster at 30 units than one call of `math.tanh` each. NaN stays NaN.
    """
    bits = power.view(np.int64)
    for i in range(len(x)):
        d = 2.0 * min(max(x[i], -_FLAT), _FLAT)
        power[i] = d * _LOG2_E + _ROUND
        k = power[i] - _ROUND
        r = (d - k * _LN2_HIGH) - k * _LN2_LOW
        p = ((((_F13 * r + _F12) * r + _F11) * r + _F10) * r + _F9) * r + _F8
        p = (((((p * r + _F7) * r + _F6) * r + _F5) * r + _F4) * r + _F3) * r + _F2
        found[i] = p * r * r + r
    for i in range(len(x)):
        bits[i] = (bits[i] << _EXPONENT) + _BIAS
    for i in range(len(x)):
        e = power[i] * found[i] + (power[i] - 1.0)
        found[i] = e / (e + 2.0)


@compiled(exact=False)
def _push(register: FloatArray, newest: FloatArray) -> None:
    """Shift `newest` in at the front of `register`."""
    count = len(newest)
    for j in range(len(register) - 1, count - 1, -1):
        register[j] = register[j - count]
    for o in range(count):
        register[o] = newest[o]


@compiled(exact=False)
def free_run(
    drive_hidden: FloatArray,
    drive_linear: FloatArray,
    feedback: Feedback,
    restarts: tuple[IntArray, FloatArray],
    bounds: tuple[FloatArray, FloatArray, FloatArray],
) -> Run:
    """Run the network on its own outputs.

    `feedback` is (W1y' (m, h), W2 (o, h), Ay (o, m)); `bounds` are low (o,), high (o,) and a
    limit (T, o) on the magnitude at each step, which has no rows where there is none. Returns
    outputs (T, o), tanh activations (T, h) and what was fed back into each step (T, m).
    """
    w1y, w2, ay = feedback  # w1y is transposed
    positions, histories = restarts
    low, high, limit = bounds
    steps, hidden = drive_hidden.shape
    outputs = drive_linear.shape[1]
    m = histories.shape[1]
    history = np.zeros(m)
    y = np.empty((steps, outputs))
    active = np.empty((steps, hidden))
    fed = np.empty((steps, m))
    z, power = np.empty(hidden), np.empty(hidden)
    window = 0
    for k in range(steps):
        if window < len(positions) and positions[window] == k:
            history[:] = histories[window]
            window += 1
        fed[k] = history
        z[:] = drive_hidden[k]
        for j in range(m):
            for i in range(hidden):
                z[i] += w1y[j, i] * history[j]
        tanh_of(z, active[k], power)
        for o in range(outputs):
            v = drive_linear[k, o]
            for j in range(m):
                v += ay[o, j] * history[j]
            for i in range(hidden):
                v += w2[o, i] * active[k, i]
            # Written so that an overflow to NaN, too, ends inside the bounds.
            y[k, o] = min(v, high[o]) if v > low[o] else low[o]
            if len(limit) > 0:
                y[k, o] = max(min(y[k, o], limit[k, o]), -limit[k, o])
        _push(history, y[k])
    return y, active, fed


@compiled(exact=False)
def fading(increments: FloatArray, state: FloatArray, keep: float) -> FloatArray:
    """Envelope (T, o) of what a slow first-order lag behind moving targets would be off by.

    `increments` (T, o) are those of the targets, `keep` is the lag's pole. With the lag's error
    e(k) = keep (e(k-1) + increment(k)), the envelope is E(k) = max(|e(k)|, keep E(k-1)).
    `state` (2, o) holds e and E before the first step, and is left at their last values.
    """
    steps, outputs = increments.shape
    envelope = np.empty((steps, outputs))
    for k in range(steps):
        for o in range(outputs):
            state[0, o] = keep * (state[0, o] + increments[k, o])
            state[1, o] = max(abs(state[0, o]), keep * state[1, o])
            envelope[k, o] = state[1, o]
    return envelope


@compiled(exact=False)
def _gain(active: FloatArray, feedback: Feedback, gain: FloatArray) -> None:
    """Fill `gain` (o, m) with dy(k)/dhistory at tanh activations `active` (h,)."""
    w1y, w2, ay = feedback
    for o in range(gain.shape[0]):
        for j in range(gain.shape[1]):
            gain[o, j] = ay[o, j]
            for i in range(len(active)):
                gain[o, j] += w2[o, i] * (1.0 - active[i] * active[i]) * w1y[j, i]


@compiled(exact=False)
def adjoint(
    outer: FloatArray,
    run: Run,
    feedback: Feedback,
    positions: IntArray,
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Back-propagate through time: from dLoss/dy (T, o) to the loss's sensitivities.

    `run` is what `free_run` returned, `positions` (n,) are its restarts. Returns `total` (T, o) =
    dLoss/d(drive_linear), `hidden` (T, h) = dLoss/d(drive_hidden) and dLoss/d(histories) (n, m).
    """
    y, active, _ = run
    w1y, w2, ay = feedback
    low, high = bounds
    steps, outputs = outer.shape
    m = ay.shape[1]
    # pending[j] is dLoss/d(history entry j) as seen from the step in hand.
    pending = np.zeros(m + outputs)
    total = np.zeros((steps, outputs))
    hidden = np.zeros(active.shape)
    before = np.zeros((len(positions), m))
    window = len(positions) - 1
    for k in range(steps - 1, -1, -1):
        back = hidden[k]
        for o in range(outputs):
            if low[o] < y[k, o] < high[o]:
                total[k, o] = outer[k, o] + pending[o]
                for i in range(len(back)):
                    back[i] += total[k, o] * w2[o, i]
        for i in range(len(back)):
            back[i] *= 1.0 - active[k, i] * active[k, i]
        for j in range(m):
            passed = pending[j + outputs]
            for o in range(outputs):
                passed += total[k, o] * ay[o, j]
            for i in range(len(back)):
                passed += back[i] * w1y[j, i]
            pending[j] = passed
        if window >= 0 and positions[window] == k:
            before[window] = pending[:m]
            pending[:] = 0.0
            window -= 1
    return total, hidden, before


@compiled(exact=False)
def _direct(
    row: FloatArray,
    sample: tuple[int, int, float],
    features: tuple[FloatArray, FloatArray],
    weights: FloatArray,
) -> None:
    """Add `sign` times dy_o/dtheta at fixed history to `row` (P,).

    `sample` is (step, output, sign); `features` are phi (T, f) and activations (T, h);
    `weights` is W2.
    """
    k, o, sign = sample
    phi, active = features
    outputs, units = weights.shape
    width = phi.shape[1]
    at_b1 = units * width
    at_w2 = at_b1 + units
    at_a = at_w2 + outputs * units + outputs
    for i in range(units):
        c = sign * weights[o, i] * (1.0 - active[k, i] * active[k, i])
        for j in range(width):
            row[i * width + j] += c * phi[k, j]
        row[at_b1 + i] += c
        row[at_w2 + o * units + i] += sign * active[k, i]
    row[at_a - outputs + o] += sign
    for j in range(width):
        row[at_a + o * width + j] += sign * phi[k, j]


@compiled(exact=False)
def _recall(row: FloatArray, gain: FloatArray, ring: FloatArray, slot: int) -> None:
    """Add what the history passes on, the gains (m,) times its sensitivities, to `row` (P,).

    `ring` is (lags + 1, o, P) in the order of steps, `slot` the place of the step in hand.
    """
    lags, outputs = len(ring) - 1, ring.shape[1]
    for lag in range(lags):
        slot = slot - 1 if slot > 0 else lags
        for o in range(outputs):
            g = gain[lag * outputs + o]
            if g != 0.0:
                past = ring[slot, o]
                for p in range(len(row)):
                    row[p] += g * past[p]


@compiled(exact=False)
def jacobian(
    features: tuple[FloatArray, FloatArray, FloatArray],
    run: Run,
    feedback: Feedback,
    restarts: tuple[IntArray, FloatArray],
    scored: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Weighted forward sensitivities root dy/dtheta (rows, P) along a free run, for Gauss-Newton.

    `features` is phi (T, f), rest (T, f) and the tanh activations at rest (T, h); the latter two
    have no rows if the network is not anchored. `restarts` is (positions (n,), memory (lags, o,
    P)): dhistory/dtheta at the start, newest first, left at its value at the end, so that a long
    run can be done in blocks. `scored` is low (o,), high (o,) and root (T, o), the roots of the
    weights: where one is zero there is no row.

    Only the last `lags` steps are held besides the result, each at a place of its own in a
    ring, so that nothing is shifted and the work stays in the processor's cache.
    """
    phi, rest, rest_active = features
    y, active, _ = run
    positions, memory = restarts
    low, high, root = scored
    lags, outputs, size = memory.shape
    gain = np.empty((outputs, lags * outputs))
    result = np.empty((np.count_nonzero(root > 0.0), size))
    ring = np.empty((lags + 1, outputs, size))
    ring[:lags] = memory[::-1]
    slot, window, n = lags, 0, 0
    for k in range(len(y)):
        if window < len(positions) and positions[window] == k:
            ring[:] = 0.0
            window += 1
        _gain(active[k], feedback, gain)
        for o in range(outputs):
            row = ring[slot, o]
            row[:] = 0.0
            if low[o] < y[k, o] < high[o]:
                _direct(row, (k, o, 1.0), (phi, active), feedback[1])
                if len(rest):
                    _direct(row, (k, o, -1.0), (rest, rest_active), feedback[1])
                _recall(row, gain[o], ring, slot)
            if root[k, o] > 0.0:
                result[n] = root[k, o] * row
                n += 1
        slot = slot + 1 if slot < lags else 0
    for lag in range(lags):
        slot = slot - 1 if slot > 0 else lags
        memory[lag] = ring[slot]
    return result
