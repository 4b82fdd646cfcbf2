"""Compiled closed-loop kernels of the NARX network, and nothing else.

The network (the calibration paper, equations 2 and 3, plus a linear path) is

    y(k) = clip( b2 + A phi(k) + W2 tanh(b1 + W1 phi(k)),  low, high )
    phi(k) = [ y(k-1) .. y(k-n),  u(k-d1) .. u(k-dm) ]

An *anchored* network subtracts its own value at rest, `W2 tanh(b1 + W1 rest(k)) + A rest(k)`,
where `rest` is phi with the feedback and all moving inputs set to zero; it has no b2.

What the inputs drive, `W1u phi_u`, is a matrix product of a block of steps. Only the feedback part,
`W1y` and `Ay`, is left in the recursion. The PyTorch module in `narx.module` is the slow exact
twin of these functions and their test.

Several windows are run as one: `restarts` is (positions (n,), histories (n, m)), the steps at
which a window begins and the outputs just before it.

Loops over the hidden units are innermost, contiguous and over a multiple of 8 units, so that they
run in the processor's vector registers without a rest: the arrays are padded with units of zero
weight, and W1 is stored transposed. No loop takes a slice, which would cost as much as the loop.

Shapes: T steps, o outputs, h hidden units, H of them padded, m = lags * o feedback entries (newest
lag first), t = input taps * inputs, f = m + t features, P parameters in the order W1 (h, f),
b1 (h), W2 (o, h), b2 (o), A (o, f), each flattened by rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

# Outputs (T, o), what was fed back into each step (T, m), activations (T, H) and those at rest.
Run = tuple[FloatArray, FloatArray, FloatArray, FloatArray]

PADDING = 8  # units are padded to a multiple: the doubles in the widest vector register
_BLOCK = 128  # steps driven at a time: at 30 units 32 KiB, which stay in the nearest cache


class Layers(NamedTuple):
    """The network's arrays as the kernels take them, the first `units` of H units not padding.

    w1y (m, H), w1u (t, H) and b1 (H,) of the hidden layer; w1r (t, H) is w1u without what moves,
    and has no rows unless the network is anchored. w2 (o, H), ay (o, m), au (t, o) and b2 (o,) of
    the output; with an anchor au is zero but for what moves, and b2 is zero.
    """

    w1y: FloatArray
    w1u: FloatArray
    w1r: FloatArray
    b1: FloatArray
    w2: FloatArray
    ay: FloatArray
    au: FloatArray
    b2: FloatArray
    units: int


_LOG2_E = 1.4426950408889634
# In one part: its error of 2e-17 counts k times in r, by which tanh changes at most 2 / 2^k times.
_LN2 = 0.6931471805599453
_ROUND = 1.5 * 2.0**52  # x + this has the nearest integer to x in its lowest bits
_EXPONENT, _BIAS = 52, 1023 << 52  # where a double keeps the power of two, and that of 1
_FLAT = 20.0  # tanh is 1 to the last digit from here on
# 1 / n! for n = 2 to 13; with |r| <= ln 2 / 2 the first term left out is 4e-18 of the value.
_F2, _F3, _F4, _F5, _F6, _F7, _F8, _F9, _F10, _F11, _F12, _F13 = (
    1.0 / math.factorial(n) for n in range(2, 14)
)


@compiled(fused=True)  # with its sums reordered, x + _ROUND - _ROUND would be x
def _tanh(x: float) -> float:
    """Return tanh(x) to 5e-16 of its value, without a branch or a call: a loop is vectorised.

    With d = 2 x = k ln 2 + r, expm1(d) = 2^k expm1(r) + (2^k - 1), expm1(r) by its power series in
    pairs (Estrin), and tanh(x) = expm1(d) / (expm1(d) + 2). NaN stays NaN.
    """
    near = min(max(x, -_FLAT), _FLAT)
    rounded = np.float64(near * (2.0 * _LOG2_E) + _ROUND)
    r = 2.0 * near - (rounded - _ROUND) * _LN2
    r2 = r * r
    p = (_F10 + _F11 * r) + (_F12 + _F13 * r) * r2
    p = ((_F6 + _F7 * r) + (_F8 + _F9 * r) * r2) + p * (r2 * r2)
    p = ((_F2 + _F3 * r) + (_F4 + _F5 * r) * r2) + p * (r2 * r2)
    power = np.int64((rounded.view(np.int64) << _EXPONENT) + _BIAS).view(np.float64)
    e = power * (p * r2 + r) + (power - 1.0)
    return float(e / (e + 2.0))


@compiled
def tanh_of(x: FloatArray, found: FloatArray) -> None:
    for i in range(len(x)):
        found[i] = _tanh(x[i])


@compiled(exact=False)
def _drive(
    block: FloatArray, layers: Layers, driven: tuple[FloatArray, FloatArray, FloatArray]
) -> None:
    """Fill the first rows of `driven` with what the inputs of a block drive, units at rest last."""
    drive, linear, still = driven
    np.dot(block, layers.w1u, drive[: len(block)])
    np.dot(block, layers.au, linear[: len(block)])
    if len(layers.w1r):
        np.dot(block, layers.w1r, still[: len(block)])


@compiled(exact=False, inline=True)
def _activate(
    driven: tuple[FloatArray, int], layers: Layers, history: FloatArray, active: FloatArray
) -> None:
    """Fill `active` (H,) with tanh(b1 + drive + W1y history), by a row of `driven`.

    The newest entry comes last, since only it is not known long before.
    """
    drive, b = driven
    for i in range(len(active)):
        active[i] = layers.b1[i] + drive[b, i]
    for j in range(1, len(history)):
        for i in range(len(active)):
            active[i] += layers.w1y[j, i] * history[j]
    for i in range(len(active)):
        active[i] = _tanh(active[i] + layers.w1y[0, i] * history[0])


@compiled(exact=False)
def _output(o: int, layers: Layers, history: FloatArray, active: FloatArray) -> float:
    """Output `o` before its bound, without what the inputs drive."""
    v = layers.b2[o]
    for j in range(len(history)):
        v += layers.ay[o, j] * history[j]
    for i in range(len(active)):
        v += layers.w2[o, i] * active[i]
    return float(v)


@compiled
def _within(value: float, low: float, high: float) -> float:
    """Clip `value`, so that an overflow to NaN, too, ends inside the bounds."""
    return min(value, high) if value > low else low


@compiled(exact=False)
def _push(history: FloatArray, y: FloatArray, k: int) -> None:
    """Shift the outputs at step `k` in at the front of `history`."""
    outputs = y.shape[1]
    for j in range(len(history) - 1, outputs - 1, -1):
        history[j] = history[j - outputs]
    for o in range(outputs):
        history[o] = y[k, o]


@compiled(exact=False)
def free_run(
    tapped: FloatArray,
    layers: Layers,
    restarts: tuple[IntArray, FloatArray],
    bounds: tuple[FloatArray, FloatArray, FloatArray],
    keep: bool,
) -> Run:
    """Run the network over tapped inputs (T, t) on its own outputs.

    `bounds` are low (o,), high (o,) and a limit (T, o) on the magnitude at each step, which has no
    rows where there is none. Without `keep` no activations are returned: their arrays have no rows.
    """
    positions, histories = restarts
    low, high, limit = bounds
    steps, units = len(tapped), len(layers.b1)
    outputs, m = layers.ay.shape
    anchored = len(layers.w1r) > 0
    y, fed = np.empty((steps, outputs)), np.empty((steps, m))
    active = np.empty((steps if keep else 0, units))
    resting = np.empty((steps if keep and anchored else 0, units))
    driven = np.empty((_BLOCK, units)), np.empty((_BLOCK, outputs)), np.empty((_BLOCK, units))
    drive, linear, still = driven
    history, t, rest = np.zeros(m), np.empty(units), np.zeros(units)
    window = 0
    for k in range(steps):
        b = k % _BLOCK
        if b == 0:
            _drive(tapped[k : k + _BLOCK], layers, driven)
        if window < len(positions) and positions[window] == k:
            for j in range(m):
                history[j] = histories[window, j]
            window += 1
        for j in range(m):
            fed[k, j] = history[j]
        _activate((drive, b), layers, history, t)
        for i in range(units if keep else 0):
            active[k, i] = t[i]
        for i in range(units if anchored else 0):
            rest[i] = _tanh(layers.b1[i] + still[b, i])
            t[i] -= rest[i]
        for i in range(units if keep and anchored else 0):
            resting[k, i] = rest[i]
        for o in range(outputs):
            v = linear[b, o] + _output(o, layers, history, t)
            v = _within(v, low[o], high[o])
            y[k, o] = _within(v, -limit[k, o], limit[k, o]) if len(limit) else v
        _push(history, y, k)
    return y, fed, active, resting


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


@compiled(exact=False, inline=True)
def _pass_back(
    pending: FloatArray, layers: Layers, total: tuple[FloatArray, int], back: FloatArray
) -> None:
    """Move `pending` (m + o,) one step back, through `total` (T, o) at a step and `back` (H,)."""
    slopes, k = total
    outputs, m = layers.ay.shape
    for j in range(m):
        passed = pending[j + outputs]
        for o in range(outputs):
            passed += slopes[k, o] * layers.ay[o, j]
        for i in range(len(back)):
            passed += back[i] * layers.w1y[j, i]
        pending[j] = passed


@compiled(exact=False)
def adjoint(
    outer: FloatArray,
    run: Run,
    layers: Layers,
    positions: IntArray,
    bounds: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Back-propagate through time: from dLoss/dy (T, o) to the loss's sensitivities.

    `run` is what `free_run` returned, `positions` (n,) are its restarts. Returns `total` (T, o) =
    dLoss/d(output before its bound), `hidden` (T, H) = dLoss/d(W1 phi) and dLoss/d(histories)
    (n, m).
    """
    y, _, active, _ = run
    low, high = bounds
    steps, units = active.shape
    outputs, m = layers.ay.shape
    # pending[j] is dLoss/d(history entry j) as seen from the step in hand.
    pending, back = np.zeros(m + outputs), np.empty(units)
    total, hidden = np.zeros((steps, outputs)), np.empty((steps, units))
    before = np.zeros((len(positions), m))
    window = len(positions) - 1
    for k in range(steps - 1, -1, -1):
        back[:] = 0.0
        for o in range(outputs):
            if low[o] < y[k, o] < high[o]:
                total[k, o] = outer[k, o] + pending[o]
                for i in range(units):
                    back[i] += total[k, o] * layers.w2[o, i]
        for i in range(units):
            back[i] *= 1.0 - active[k, i] * active[k, i]
            hidden[k, i] = back[i]
        _pass_back(pending, layers, (total, k), back)
        if window >= 0 and positions[window] == k:
            before[window] = pending[:m]
            pending[:] = 0.0
            window -= 1
    return total, hidden, before


@compiled(exact=False)
def _gain(active: FloatArray, layers: Layers, gain: FloatArray) -> None:
    """Fill `gain` (o, m) with dy(k)/dhistory at tanh activations `active` (H,)."""
    for o in range(gain.shape[0]):
        for j in range(gain.shape[1]):
            gain[o, j] = layers.ay[o, j]
            for i in range(len(active)):
                slope = 1.0 - active[i] * active[i]
                gain[o, j] += layers.w2[o, i] * slope * layers.w1y[j, i]


@compiled(exact=False)
def _direct(
    row: FloatArray,
    sample: tuple[int, int, float],
    features: tuple[FloatArray, FloatArray],
    layers: Layers,
) -> None:
    """Add `sign` times dy_o/dtheta at fixed history to `row` (P,).

    `sample` is (step, output, sign); `features` are phi (T, f) and activations (T, H).
    """
    k, o, sign = sample
    phi, active = features
    outputs, units = len(layers.b2), layers.units
    width = phi.shape[1]
    at_w2 = units * width + units
    at_b2 = at_w2 + outputs * units
    # Slices, since an index that might be negative keeps a loop out of vector registers.
    by_b1, by_w2 = row[units * width :], row[at_w2 + o * units :]
    by_a = row[at_b2 + outputs + o * width :]
    for i in range(units):
        c = sign * layers.w2[o, i] * (1.0 - active[k, i] * active[k, i])
        by_w1 = row[i * width :]
        for j in range(width):
            by_w1[j] += c * phi[k, j]
        by_b1[i] += c
        by_w2[i] += sign * active[k, i]
    row[at_b2 + o] += sign
    for j in range(width):
        by_a[j] += sign * phi[k, j]


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
    features: tuple[FloatArray, FloatArray],
    run: Run,
    layers: Layers,
    restarts: tuple[IntArray, FloatArray],
    scored: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Weighted forward sensitivities root dy/dtheta (rows, P) along a free run, for Gauss-Newton.

    `features` is phi (T, f) and phi at rest (T, f), which has no rows if the network is not
    anchored. `restarts` is (positions (n,), memory (lags, o,
    P)): dhistory/dtheta at the start, newest first, left at its value at the end, so that a long
    run can be done in blocks. `scored` is low (o,), high (o,) and root (T, o), the roots of the
    weights: where one is zero there is no row.

    Only the last `lags` steps are held besides the result, each at a place of its own in a
    ring, so that nothing is shifted and the work stays in the processor's cache.
    """
    phi, rest = features
    y, _, active, resting = run
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
        _gain(active[k], layers, gain)
        for o in range(outputs):
            row = ring[slot, o]
            row[:] = 0.0
            if low[o] < y[k, o] < high[o]:
                _direct(row, (k, o, 1.0), (phi, active), layers)
                if len(rest):
                    _direct(row, (k, o, -1.0), (rest, resting), layers)
                _recall(row, gain[o], ring, slot)
            if root[k, o] > 0.0:
                result[n] = root[k, o] * row
                n += 1
        slot = slot + 1 if slot < lags else 0
    for lag in range(lags):
        slot = slot - 1 if slot > 0 else lags
        memory[lag] = ring[slot]
    return result
