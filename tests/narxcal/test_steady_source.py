"""The maker's model, opened from a configuration."""

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.function import SteadyCallable
from narxcal.steady.model import SteadyOptions, open_steady
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ConfigError

NAMES = (("TRA_deg", "Mach"), ("N1_pct",))


def test_a_table_beside_the_configuration(tmp_path):
    rows = "TRA_deg,Mach,N1_pct\n0,0,20\n0,1,15\n30,0,60\n30,1,55\n"
    (tmp_path / "deck.csv").write_text(rows, encoding="utf-8")
    deck = open_steady("table", "deck.csv", NAMES, tmp_path, SteadyOptions(method="pchip"))
    assert isinstance(deck, SteadyTable)
    assert deck.method == "pchip"
    np.testing.assert_allclose(deck.outputs([30.0, 0.5]), [57.5])


def test_a_function_beside_the_configuration_with_its_envelope(tmp_path):
    (tmp_path / "own_deck.py").write_text("def f(u): return u[:, :1]\n", encoding="utf-8")
    options = SteadyOptions(ranges={"TRA_deg": (0.0, 78.0)})
    deck = open_steady("callable", "own_deck:f", NAMES, tmp_path, options)
    assert isinstance(deck, SteadyCallable)
    np.testing.assert_allclose(deck.outputs([99.0, 0.5]), [78.0])


def test_an_fmu_beside_the_configuration_with_its_options(tmp_path):
    spec = spec_from_file_location("fmu_source", Path(__file__).with_name("fmu_source.py"))
    source = module_from_spec(spec)
    spec.loader.exec_module(source)
    source.build(tmp_path / "deck.fmu", 2)
    options = SteadyOptions(variables={"EGT_C": "ITT"}, settle_s=5.0)
    deck = open_steady("fmu", "deck.fmu", (NAMES[0], ("EGT_C",)), tmp_path, options)
    assert isinstance(deck, SteadyFmu)
    assert deck.options.settle_s == 5.0
    np.testing.assert_allclose(deck.outputs([10.0, 0.5]), [340.0])


def test_another_kind_is_refused():
    message = "unknown kind of steady-state source 'fitted'. Use table, callable or fmu"
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        open_steady("fitted", "", NAMES)
