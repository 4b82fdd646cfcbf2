"""One channel on a uniform grid: two rows at one stamp."""

import numpy as np

from data_prep.sources.grid import Grid, resample


def on_grid(time, values, interval_s=0.1, samples=41):
    grid = Grid(0.0, interval_s, samples, 2.0)
    return resample("TRA_deg", np.array(time), np.array(values), grid, hold=False)


def test_two_rows_at_one_stamp_are_a_step_and_no_ramp_before_it():
    values, _ = on_grid([0.0, 1.0, 2.0, 2.0, 3.0, 4.0], [20.0, 20.0, 20.0, 60.0, 60.0, 60.0])
    np.testing.assert_allclose(values[:20], 20.0)
    np.testing.assert_allclose(values[20:], 60.0)


def test_lines_end_at_the_first_row_of_a_stamp_and_begin_at_its_last():
    values, _ = on_grid([0.0, 2.0, 2.0, 2.0, 4.0], [0.0, 10.0, 99.0, 20.0, 40.0])
    np.testing.assert_allclose(values[:20], 0.5 * np.arange(20))
    np.testing.assert_allclose(values[20:], 20.0 + np.arange(21))
