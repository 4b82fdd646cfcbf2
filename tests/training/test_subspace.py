"""Subspace identification: known plants, oracles, several records, and what bad input gives."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from narxcal.state_space import StateSpace
from narxcal.support.errors import DataError
from training.papers.subspace import (
    SubspaceSettings,
    initial_state,
    input_matrices,
    subspace,
)

DT = 0.1
SETTINGS = SubspaceSettings(dt_s=DT)


def plant(xi=0.4, omega=2.0):
    A = np.array([[0.0, 1.0], [-(omega**2), -2.0 * xi * omega]])
    B = np.array([[0.0], [omega**2]])
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    return StateSpace(whole[:2, :2], whole[:2, 2:], np.array([[1.0, 0.0]]), np.zeros((1, 1)), DT)


def held_noise(random, count, channels=1):
    return np.repeat(random.standard_normal((count // 8 + 1, channels)), 8, axis=0)[:count]


def record(model, random, count=700, snr_db=np.inf):
    u = held_noise(random, count, model.B.shape[1])
    y = model.simulate(u, random.standard_normal(model.order))
    noise = y.std(axis=0) * 10.0 ** (-snr_db / 20.0)
    return u, y + noise * random.standard_normal(y.shape)


def pole_error(found, truth):
    """Relative error of the poles in continuous time."""
    ours, theirs = (np.sort_complex(np.log(model.poles)) for model in (found, truth))
    return np.max(np.abs(ours - theirs) / np.abs(theirs))


@pytest.mark.parametrize(("xi", "omega"), [(0.4, 2.0), (1.5, 2.0)])
@pytest.mark.parametrize("seed", range(3))
def test_poles_of_a_second_order_plant_at_40_db_are_within_one_percent(xi, omega, seed):
    random, truth = np.random.default_rng(seed), plant(xi, omega)
    records = [record(truth, random, 700, 40.0) for _ in range(3)]
    found = subspace(records, 2, 12, SETTINGS)
    assert pole_error(found.model, truth) < 0.01
    assert found.model.gain[0, 0] == pytest.approx(1.0, abs=0.01)


def test_the_polish_ends_at_the_output_error_of_the_canonical_form():
    random, truth = np.random.default_rng(1), plant(1.5, 2.0)
    records = [record(truth, random, 400, 40.0) for _ in range(2)]

    def residuals(c):
        A = np.array([[-c[0], 1.0], [-c[1], 0.0]])
        model, x0 = input_matrices(A, np.array([[1.0, 0.0]]), records, DT)
        errors = [y - model.simulate(u, x) for (u, y), x in zip(records, x0, strict=True)]
        return np.concatenate(errors).ravel()

    oracle = least_squares(residuals, np.poly(truth.poles).real[1:], xtol=1e-12, ftol=1e-12)
    ours = subspace(records, 2, 12, SETTINGS)
    assert ours.rmse[0] == pytest.approx(np.sqrt(np.mean(oracle.fun**2)), rel=1e-6)
    np.testing.assert_allclose(np.poly(ours.model.poles).real[1:], oracle.x, rtol=1e-4)
    plain = subspace(records, 2, 12, SubspaceSettings(dt_s=DT, polish=False))
    assert plain.rmse[0] > ours.rmse[0]


def test_exact_data_give_the_exact_model_and_initial_states():
    random, truth = np.random.default_rng(0), plant()
    records = [record(truth, random, 200) for _ in range(2)]
    found = subspace(records, 2, 8, SETTINGS)
    assert pole_error(found.model, truth) < 1e-8
    for (u, y), x0 in zip(records, found.x0, strict=True):
        np.testing.assert_allclose(found.model.simulate(u, x0), y, atol=1e-8)
        np.testing.assert_allclose(initial_state(found.model, (u, y)), x0, atol=1e-6)
    assert found.rmse.max() < 1e-8


def test_several_inputs_and_outputs_of_very_different_size():
    random = np.random.default_rng(3)
    A = np.diag([0.95, 0.8, 0.5])
    scale = np.array([[1e-3], [1e4]])
    truth = StateSpace(A, random.standard_normal((3, 2)), scale * random.standard_normal((2, 3)),
                       np.zeros((2, 2)), DT)  # fmt: skip
    records = [record(truth, random, 400) for _ in range(2)]
    found = subspace(records, 3, 6, SETTINGS)
    np.testing.assert_allclose(np.sort(found.model.poles.real), [0.5, 0.8, 0.95], atol=1e-8)
    np.testing.assert_allclose(found.model.gain / scale, truth.gain / scale, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_one_record_as_nfoursid_has_it(seed):
    nfoursid = pytest.importorskip("nfoursid.nfoursid")
    random = np.random.default_rng(seed)
    u, y = record(plant(), random, 900, 40.0)
    table = pd.DataFrame({"u": u[:, 0], "y": y[:, 0]})
    oracle = nfoursid.NFourSID(table, output_columns=["y"], input_columns=["u"], num_block_rows=10)
    oracle.subspace_identification()
    theirs, _ = oracle.system_identification(rank=2)
    ours = subspace([(u, y)], 2, 10, SubspaceSettings(dt_s=DT, polish=False)).model
    np.testing.assert_allclose(
        np.sort_complex(ours.poles), np.sort_complex(np.linalg.eigvals(theirs.a)), rtol=2e-3
    )


def test_no_window_crosses_a_border():
    # Exact records give the exact plant; put end to end they are no record of it at the border.
    random, truth = np.random.default_rng(1), plant()
    records = [record(truth, random, 100) for _ in range(2)]
    joined = tuple(np.vstack(part) for part in zip(*records, strict=True))
    settings = SubspaceSettings(dt_s=DT, polish=False)
    assert pole_error(subspace(records, 2, 10, settings).model, truth) < 1e-8
    assert pole_error(subspace([joined], 2, 10, settings).model, truth) > 1e-3


def test_order_of_records_does_not_matter():
    random, truth = np.random.default_rng(2), plant()
    records = [record(truth, random, 300, 40.0) for _ in range(3)]
    one, other = (subspace(r, 2, 8, SETTINGS).model for r in (records, records[::-1]))
    np.testing.assert_allclose(one.markov(20), other.markov(20), atol=1e-9)


@pytest.mark.parametrize("count", [1, 3])
def test_the_order_is_found_by_the_held_out_free_run(count):
    random, truth = np.random.default_rng(4), plant()
    records = [record(truth, random, 600, 40.0) for _ in range(count)]
    found = subspace(records, None, 10, SETTINGS)
    assert found.model.order == 2
    assert found.status.startswith("order 2 by the free run on held-out data (1: ")


def test_too_little_is_left_to_choose_an_order():
    # 47 windows for 32 rows are enough, but not those of the first two thirds of the record.
    u, y = record(plant(), np.random.default_rng(8), 62)
    assert subspace([(u, y)], 2, 8, SETTINGS).model.order == 2
    with pytest.raises(DataError, match=r"^26 windows for 32 rows of the Hankel matrices: fewer"):
        subspace([(u, y)], None, 8, SETTINGS)


def test_b_and_x0_are_the_least_squares_solution_over_all_rows():
    random, truth = np.random.default_rng(5), plant()
    records = [record(truth, random, 60, 20.0) for _ in range(2)]
    model, x0 = input_matrices(truth.A, truth.C, records, SETTINGS)
    # The slow way: one column per unknown (B, then x0 of each record), all rows at once.
    columns = []
    for k in range(2):
        unit = StateSpace(truth.A, np.eye(2)[:, [k]], truth.C, truth.D, DT)
        columns.append(np.concatenate([unit.simulate(u)[:, 0] for u, _ in records]))
    for r in range(2):
        for k in range(2):
            parts = [truth.simulate(0 * u, np.eye(2)[k] * (j == r))[:, 0]
                     for j, (u, _) in enumerate(records)]  # fmt: skip
            columns.append(np.concatenate(parts))
    y = np.concatenate([y[:, 0] for _, y in records])
    slow = np.linalg.lstsq(np.column_stack(columns), y, rcond=None)[0]
    np.testing.assert_allclose([*model.B[:, 0], *np.concatenate(x0)], slow, rtol=1e-8)


def test_poles_outside_the_unit_circle_are_moved_inside_and_said_so():
    random = np.random.default_rng(6)
    growing = StateSpace(*(np.array([[v]]) for v in (1.02, 1.0, 1.0, 0.0)), DT)
    settings = SubspaceSettings(dt_s=DT, polish=False)
    found = subspace([record(growing, random, 150)], 1, 4, settings)
    assert found.model.poles[0].real == pytest.approx(1.0 / 1.02, abs=1e-6)
    assert "1 poles on or outside the unit circle were moved inside" in found.advice


def step_record(quiet, count=120):
    u = np.zeros((count, 1))
    u[quiet:] = 1.0
    return u, plant().simulate(u)


def test_a_step_after_quiet_samples_identifies_the_plant():
    found = subspace([step_record(20)], 2, 8, SETTINGS)
    assert pole_error(found.model, plant()) < 1e-6


def test_a_step_in_the_first_sample_is_refused():
    message = (
        r"^the input Hankel matrix has rank 1 of 16: the records together are not persistently "
        r"exciting of order 16 \(rank by record: 0: 1\)\. Keep at least 16 quiet samples before a "
        r"step, lower block_rows, or add records with other inputs$"
    )
    with pytest.raises(DataError, match=message):
        subspace([step_record(0)], 2, 8, SETTINGS)


def test_a_record_whose_input_never_moves_is_named():
    random, truth = np.random.default_rng(7), plant()
    still = np.zeros((80, 1)), truth.simulate(np.zeros((80, 1)), np.ones(2))
    moving = record(truth, random, 400)
    found = subspace([moving, still], 2, 8, SETTINGS)
    assert "the input never moves in record 1" in found.advice
    assert pole_error(found.model, truth) < 1e-6
    with pytest.raises(DataError, match=r"^the input Hankel matrix has rank 0 of 16"):
        subspace([still], 2, 8, SETTINGS)


U, Y = np.zeros((40, 1)), np.zeros((40, 1))
GAP = np.where(np.arange(40)[:, None] == 17, np.nan, 0.0)


REFUSED = {
    "subspace identification needs at least one record, found none": ([], 2),
    "expected block_rows >= 2 and an order from 1 to block_rows * outputs - 1, found "
    "block_rows 8, order 9, 1 outputs": ([(U, Y)], 9),
    "record 1: expected u (time, 1) and y (time, 1), found (9, 1), (8, 1)": (
        [(U, Y), (U[:9], Y[:8])], 2,
    ),
    "row 17: record 0 has a value that is not finite. Cut the record there: no window may cross "
    "the gap": ([(U, GAP)], 2),
    "record 0 has 15 samples, fewer than the 16 of one window. Lower block_rows or leave the "
    "record out": ([(U[:15], Y[:15])], 2),
    "25 windows for 32 rows of the Hankel matrices: fewer samples than parameters. Lower "
    "block_rows or add records": ([(U, Y)], 2),
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_bad_records_are_refused(message):
    records, order = REFUSED[message]
    with pytest.raises(DataError, match=f"^{re.escape(message)}$"):
        subspace(records, order, 8)
