"""Subspace identification of a state-space model from several records (PO-MOESP).

| symbol | meaning |
|---|---|
| s | block rows: length of past and of future in a window of 2 s samples |
| U_p, Y_p, U_f, Y_f | block Hankel matrices of past and future inputs and outputs |
| Gamma | extended observability matrix (s outputs, n) |

The windows of all records stand side by side: none crosses a border. One LQ decomposition of
[U_f; U_p; Y_p; Y_f], updated record by record, gives the range of Gamma and its singular values;
A and C follow from its shift structure; B and the initial state of every record from one linear
least-squares problem on the free run, so that noise of the windows does not enter twice.

Records are deviations from a steady start. Sources: Verhaegen 1994 (PO-MOESP), Van Overschee and
De Moor 1996; SLICOT IB01AD for records joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from narxcal.state_space import StateSpace
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.steady.static_fit import Boxed

Record = tuple[FloatArray, FloatArray]
_WELL_COVERED = 10  # windows per row of the Hankel matrices; fewer leave a noisy estimate
_RANK = 1e-9  # singular value over the largest at which the input counts as exciting
_NO_SIGNAL = 1e-10  # singular value over the largest at which an order has nothing to describe
_ENOUGH = 1.05  # the least order within 5 % of the lowest free-run error is chosen
_INSIDE = 0.999  # modulus that a pole on the unit circle is moved to
_OUTSIDE = 1e3  # residual over the output at an unstable trial of the polish


@dataclass(frozen=True, kw_only=True)
class SubspaceSettings:
    """Sampling interval and largest order tried.

    `polish` refines A and C by output error on the free run: under noise the poles of a subspace
    estimate scatter more than the data allow.
    """

    dt_s: float = 1.0
    most: int = 8
    polish: bool = True


@dataclass(frozen=True, eq=False)
class SubspaceFit:
    """Model, initial state (n,) of every record, status and advice.

    `rmse` (outputs,) is the error of the free run over all records, in the outputs' units.
    """

    model: StateSpace
    x0: tuple[FloatArray, ...]
    rmse: FloatArray
    status: str
    advice: tuple[str, ...]


def subspace(
    records: Sequence[Record],
    order: int | None,
    block_rows: int,
    settings: SubspaceSettings | None = None,
) -> SubspaceFit:
    """Identify one model from records (u (time, inputs), y (time, outputs)).

    Without `order` the least one is chosen whose free run on held-out records (one record: on its
    last third) is within 5 % of the best. Unstable poles are reflected into the unit circle.

    Raises `DataError` naming the record for NaN, lengths that differ or a record too short; and
    where all records together do not excite 2 s block rows (a step in the first sample, an input
    that never moves).
    """
    settings = settings or SubspaceSettings()
    u_scale, y_scale = _checked(records, order, block_rows)
    scaled = [(u / u_scale, y / y_scale) for u, y in records]
    advice = _input_advice(records)
    U, singular, more = _range_of_observability(scaled, block_rows)
    advice += more
    status = f"order {order} given"
    if order is None:
        orders = _orders(singular, block_rows, settings)
        order, status = _chosen(scaled, orders, block_rows, settings)
    A, C, moved = _dynamics(U[:, :order], scaled[0][1].shape[1])
    if moved:
        advice.append(f"{moved} poles on or outside the unit circle were moved inside")
    if settings.polish:
        A, C = _polished(A, C, scaled, settings.dt_s)
    model, x0 = input_matrices(A, C, scaled, settings.dt_s)
    errors = [y - model.simulate(u, x) for (u, y), x in zip(scaled, x0, strict=True)]
    rmse = np.sqrt(np.mean(np.square(np.concatenate(errors)), axis=0)) * y_scale
    whole = StateSpace(
        model.A, model.B / u_scale, y_scale[:, np.newaxis] * model.C, model.D, settings.dt_s,
    )  # fmt: skip
    return SubspaceFit(whole, tuple(x0), rmse, status, tuple(advice))


def input_matrices(
    A: FloatArray, C: FloatArray, records: Sequence[Record], dt_s: float
) -> tuple[StateSpace, list[FloatArray]]:
    """B and every record's x0 by one linear least-squares problem on the free run.

    The x0 of a record touches its rows only: an orthogonal transformation takes them out record
    by record, and the remaining rows of all records determine B.
    """
    n, m = len(A), records[0][0].shape[1]
    parts = []
    for u, y in records:
        matrix = np.hstack([_initial_response(A, C, len(u)), _forced_response(A, C, u)])
        Q, R = np.linalg.qr(matrix)
        parts.append((R, Q.T @ y.ravel()))
    common = np.vstack([R[n:, n:] for R, _ in parts])
    target = np.concatenate([b[n:] for _, b in parts])
    theta = np.linalg.lstsq(common, target, rcond=None)[0]
    x0 = [np.linalg.lstsq(R[:n, :n], b[:n] - R[:n, n:] @ theta, rcond=None)[0] for R, b in parts]
    B = theta.reshape(m, n).T
    return StateSpace(A, B, C, np.zeros((len(C), m)), dt_s), x0


def initial_state(model: StateSpace, record: Record) -> FloatArray:
    """State (n,) at the first sample that fits the free run to `record` best."""
    u, y = record
    response = _initial_response(model.A, model.C, len(u))
    forced = (y - model.simulate(u)).ravel()
    return np.asarray(np.linalg.lstsq(response, forced, rcond=None)[0])


def _checked(records: Sequence[Record], order: int | None, s: int) -> tuple[FloatArray, FloatArray]:
    """Root mean square of inputs and outputs over all records; complaints name the record."""
    if not records:
        raise DataError("subspace identification needs at least one record, found none")
    m, p = records[0][0].shape[1], records[0][1].shape[1]
    if s < 2 or (order is not None and not 1 <= order < s * p):
        raise DataError(
            f"expected block_rows >= 2 and an order from 1 to block_rows * outputs - 1, found "
            f"block_rows {s}, order {order}, {p} outputs"
        )
    for k, (u, y) in enumerate(records):
        if u.shape != (len(y), m) or y.shape[1] != p:
            raise DataError(
                f"record {k}: expected u (time, {m}) and y (time, {p}), found {u.shape}, {y.shape}"
            )
        bad = ~np.isfinite(np.hstack([u, y])).all(axis=1)
        if bad.any():
            raise DataError(
                f"record {k} has a value that is not finite", row=int(np.argmax(bad)),
                hint="Cut the record there: no window may cross the gap",
            )  # fmt: skip
        if len(u) < 2 * s:
            raise DataError(
                f"record {k} has {len(u)} samples, fewer than the {2 * s} of one window",
                hint="Lower block_rows or leave the record out",
            )
    scales = [np.sqrt(np.mean(np.square(np.concatenate(part)), axis=0))
              for part in zip(*records, strict=True)]  # fmt: skip
    return np.where(scales[0] > 0.0, scales[0], 1.0), np.where(scales[1] > 0.0, scales[1], 1.0)


def _input_advice(records: Sequence[Record]) -> list[str]:
    quiet = [str(k) for k, (u, _) in enumerate(records) if not np.any(np.ptp(u, axis=0) > 0.0)]
    return [f"the input never moves in record {', '.join(quiet)}"] if quiet else []


def _hankel(signal: FloatArray, rows: int) -> FloatArray:
    """Block Hankel matrix (rows * channels, windows) of a signal (time, channels)."""
    windows = sliding_window_view(signal, rows, axis=0)
    return windows.transpose(2, 1, 0).reshape(-1, len(windows))


def _triangular(records: Sequence[Record], s: int) -> FloatArray:
    """L (lower triangular) of the LQ decomposition of [U_f; U_p; Y_p; Y_f] of all records."""
    R: FloatArray = np.empty((0, 0))
    for u, y in records:
        U, Y = _hankel(u, 2 * s), _hankel(y, 2 * s)
        cut = s * u.shape[1], s * y.shape[1]
        block = np.vstack([U[cut[0] :], U[: cut[0]], Y[: cut[1]], Y[cut[1] :]]).T
        R = np.asarray(np.linalg.qr(np.vstack([R, block]) if len(R) else block, mode="r"))
    return R.T


def _range_of_observability(
    records: Sequence[Record], s: int
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Left singular vectors that span Gamma, singular values, advice."""
    m, p = records[0][0].shape[1], records[0][1].shape[1]
    windows, rows = sum(len(u) - 2 * s + 1 for u, _ in records), 2 * s * (m + p)
    if windows < rows:
        raise DataError(
            f"{windows} windows for {rows} rows of the Hankel matrices: fewer samples than "
            f"parameters",
            hint="Lower block_rows or add records",
        )
    L = _triangular(records, s)
    excited = np.linalg.svd(L[: 2 * s * m, : 2 * s * m], compute_uv=False)
    rank = int(np.sum(excited > _RANK * excited[0])) if excited[0] > 0.0 else 0
    if rank < 2 * s * m:
        raise DataError(
            f"the input Hankel matrix has rank {rank} of {2 * s * m}: the records together are "
            f"not persistently exciting of order {2 * s} ({_least_exciting(records, s)})",
            hint=f"Keep at least {2 * s} quiet samples before a step, lower block_rows, or add "
            "records with other inputs",
        )
    past = slice(s * m, 2 * s * m + s * p)
    future = L[past.stop :, past]
    U, singular, _ = np.linalg.svd(future, full_matrices=False)
    few = windows < _WELL_COVERED * rows
    advice = [f"only {windows} windows for {rows} rows: expect a noisy estimate"]
    return U, singular, advice if few else []


def _least_exciting(records: Sequence[Record], s: int) -> str:
    ranks = [int(np.linalg.matrix_rank(_hankel(u, 2 * s), tol=None)) for u, _ in records]
    return "rank by record: " + ", ".join(f"{k}: {rank}" for k, rank in enumerate(ranks))


def _dynamics(U: FloatArray, outputs: int) -> tuple[FloatArray, FloatArray, int]:
    """A and C from the shift structure of Gamma, and the number of poles moved inside."""
    A = np.asarray(np.linalg.lstsq(U[:-outputs], U[outputs:], rcond=None)[0], dtype=np.float64)
    C = U[:outputs]
    poles, vectors = np.linalg.eig(A)
    size = np.abs(poles)
    out = size >= 1.0
    if not out.any():
        return A, C, 0
    inside = np.where(
        out, poles / np.maximum(size, 1e-300) * np.minimum(1.0 / size, _INSIDE), poles
    )
    return np.real(vectors @ np.diag(inside) @ np.linalg.inv(vectors)), C, int(out.sum())


def _polished(
    A: FloatArray, C: FloatArray, records: Sequence[Record], dt_s: float
) -> tuple[FloatArray, FloatArray]:
    """A and C of the least error of the free run, B and x0 being solved for at every step.

    The basis is free, so n^2 directions change nothing: the damping keeps them where they are.
    """
    n, y = len(A), np.concatenate([y for _, y in records]).ravel()

    def residuals(theta: FloatArray) -> FloatArray:
        found = []
        for row in theta.reshape(-1, A.size + C.size):
            a, c = row[: A.size].reshape(n, n), row[A.size :].reshape(-1, n)
            if np.max(np.abs(np.linalg.eigvals(a))) >= 1.0:
                found.append(_OUTSIDE * y)
                continue
            model, x0 = input_matrices(a, c, records, dt_s)
            pairs = zip(records, x0, strict=True)
            found.append(y - np.concatenate([model.simulate(u, x) for (u, _), x in pairs]).ravel())
        return np.array(found).reshape(*theta.shape[:-1], len(y))

    start = np.concatenate([A.ravel(), C.ravel()])
    width = np.full(len(start), 0.5 * np.abs(start).max())
    theta, _ = Boxed(residuals, start - width, start + width).minimum(start)
    return theta[: A.size].reshape(n, n), theta[A.size :].reshape(-1, n)


def _initial_response(A: FloatArray, C: FloatArray, count: int) -> FloatArray:
    """C A^k stacked over k: (count * outputs, n)."""
    free = StateSpace(A, np.zeros((len(A), 1)), C, np.zeros((len(C), 1)), 1.0)
    quiet = np.zeros((count, 1))
    columns = [free.simulate(quiet, unit).ravel() for unit in np.eye(len(A))]
    return np.column_stack(columns)


def _forced_response(A: FloatArray, C: FloatArray, u: FloatArray) -> FloatArray:
    """Columns of vec(B), input by input: (count * outputs, ..)."""
    none = np.zeros((len(C), 1))
    columns = [
        StateSpace(A, unit[:, np.newaxis], C, none, 1.0).simulate(u[:, j : j + 1]).ravel()
        for j in range(u.shape[1])
        for unit in np.eye(len(A))
    ]
    return np.column_stack(columns)


def _orders(singular: FloatArray, s: int, settings: SubspaceSettings) -> range:
    known = int(np.sum(singular > _NO_SIGNAL * singular[0]))
    return range(1, max(1, min(settings.most, s - 1, known)) + 1)


def _chosen(
    records: Sequence[Record], orders: range, s: int, settings: SubspaceSettings
) -> tuple[int, str]:
    """Least order whose free run on held-out data is within 5 % of the best."""
    errors = np.zeros(len(orders))
    for fitted, held in _folds(records, s):
        U = _range_of_observability(fitted, s)[0]
        for k, order in enumerate(orders):
            A, C, _ = _dynamics(U[:, :order], fitted[0][1].shape[1])
            model, _ = input_matrices(A, C, fitted, settings.dt_s)
            error = held[1] - model.simulate(held[0], initial_state(model, held))
            errors[k] += float(np.mean(np.square(error)))
    errors = np.sqrt(errors)
    order = orders[int(np.argmax(errors <= _ENOUGH * errors.min()))]
    listed = ", ".join(f"{n}: {error:.3g}" for n, error in zip(orders, errors, strict=True))
    return order, f"order {order} by the free run on held-out data ({listed})"


def _folds(records: Sequence[Record], s: int) -> list[tuple[list[Record], Record]]:
    """At most five held-out records; of one record the last third."""
    if len(records) == 1:
        u, y = records[0]
        cut = max(2 * len(u) // 3, 2 * s)
        return [([(u[:cut], y[:cut])], (u[cut:], y[cut:]))]
    held = np.unique(np.linspace(0, len(records) - 1, min(5, len(records))).round().astype(int))
    return [([r for j, r in enumerate(records) if j != k], records[k]) for k in held]
