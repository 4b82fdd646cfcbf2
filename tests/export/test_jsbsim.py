"""JSBSim's turbine takes what is fitted to a run, and what it cannot hold is said in numbers."""

import numpy as np
import pytest

from narxcal.export.jsbsim import SPOOLS, Rig, Turbine, compare, crossings
from narxcal.export.program import Program
from narxcal.export.proof import Case
from narxcal.steady.model import Envelope
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ModelError
from tests.export import models

pytest.importorskip("jsbsim", reason="needs jsbsim")
DT_S = 0.1


class Ramps:
    """A run that is of JSBSim's form: settles on a line, moves at one rate up and one down."""

    input_names, output_names, dt_s = ("TRA_deg", "ALT_ft"), SPOOLS, DT_S
    idle, span, up, down = np.array([25.0, 60.0]), np.array([70.0, 38.0]), 12.0, 7.0

    def __init__(self):
        corners = np.array([[0.0, 0.0], [0.0, 3e4], [80.0, 0.0], [80.0, 3e4]])
        settled = self.idle + corners[:, :1] / 80.0 * self.span
        self.steady = SteadyTable((self.input_names, self.output_names), corners, settled)

    def simulate(self, inputs):
        goal = self.steady.outputs(inputs)
        rows = [goal[0]]
        for row in goal[1:]:
            step = np.clip(row - rows[-1], -self.down * DT_S, self.up * DT_S)
            rows.append(rows[-1] + step)
        return np.array(rows)


@pytest.fixture(scope="module")
def fitted():
    run = Ramps()
    lever = np.repeat(np.random.default_rng(0).uniform(0.0, 80.0, 30), 80)
    case = Case("moves", "", np.column_stack([lever, np.full(len(lever), 1e4)]))
    box = Envelope(np.zeros(2), np.array([80.0, 3e4]))
    return run, Turbine.of(run, box, [case]), case


def test_a_run_of_its_form_is_held_to_its_speeds_and_rates(fitted):
    run, turbine, case = fitted
    assert turbine.idle == pytest.approx(dict(zip(SPOOLS, run.idle, strict=True)))
    assert turbine.top == pytest.approx(dict(zip(SPOOLS, run.idle + run.span, strict=True)))
    np.testing.assert_allclose(turbine.tables["N1SpoolUp"][1], run.up, rtol=0.05)
    np.testing.assert_allclose(turbine.tables["N2SpoolDown"][1], run.down, rtol=0.05)
    rows, misfit = compare(run, turbine, turbine.xml(["a test"]), [case])
    assert max(max(row["largest"].values()) for row in rows) < 1e-9
    assert max(misfit["rms"]["moves"].values()) < 0.5
    assert misfit["t90_s"]["slam"]["N1_pct"]["jsbsim"] == pytest.approx(63.0 / 12.0, abs=0.3)


def test_jsbsim_flies_the_file(fitted):
    run, turbine, _ = fitted
    found = Rig(turbine.xml(["<a> -- test"]), DT_S / 5).run(np.repeat([0.0, 1.0, 0.5], 120))
    np.testing.assert_allclose(found[[100, 220, 350]], run.idle + [[0], [1], [0.5]] * run.span)


def test_times_are_those_of_the_first_crossing():
    speed = np.array([50.0, 60.0, 90.0, 85.0, 90.0, 90.0])
    np.testing.assert_allclose(crossings(speed, np.array([0.25, 0.5]), 0.1), [0.1, 0.4 / 3.0])


def test_a_run_without_spools_is_refused():
    program = Program(models.identified(models.state_space()))
    program.model.steady = SteadyTable(
        (("TRA_deg",), ("EGT_C",)), np.array([[0.0], [80.0]]), np.array([[400.0], [700.0]])
    )
    message = "JSBSim's turbine has spool speeds, and the outputs are EGT_C. Export it as C or FMU"
    with pytest.raises(ModelError) as refused:
        Turbine.of(program.model, Envelope(np.zeros(1), np.full(1, 80.0)), [])
    assert str(refused.value) == message
