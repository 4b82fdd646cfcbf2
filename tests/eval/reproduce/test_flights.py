"""What is flown for the paper, and the maker's model as a table."""

from pathlib import Path

import numpy as np
import pytest

from eval.reproduce import data as flights
from eval.reproduce.data import TABLE, flown, paper_scenario, with_table, write_records
from narxcal.steady.opening import open_steady
from narxcal.support.errors import ConfigError
from narxcal.turbofan import maker_model
from narxcal.turbofan.engine import INPUT_NAMES

MAKER = {
    "kind": "callable",
    "source": "narxcal.turbofan:maker_model",
    "inputs": list(INPUT_NAMES),
}


def test_each_family_is_written_into_its_folder(monkeypatch):
    seen = {}

    def fake(folder, scenario, options):
        seen[folder.name] = (scenario, options)

    monkeypatch.setattr(flights, "write_flights", fake)
    write_records(Path("all"), paper_scenario(3), 2)
    assert {name: (s.records, s.engines) for name, (s, _) in seen.items()} == {
        "all": ("fast_push", ("left", "right")),
        "throttle_rate": ("throttle_rate", ("left",)),
        "take_off_approach": ("take_off_approach", ("left",)),
    }
    assert seen["all"][1].true_channels
    assert not seen["throttle_rate"][1].true_channels
    assert {s.seed for s, _ in seen.values()} == {3}
    assert {s.build_scatter_pct for s, _ in seen.values()} == {0.0}


@pytest.mark.slow
def test_the_table_takes_the_place_of_the_makers_function(tmp_path, make_config):
    by_function = make_config("elsewhere", steady_state=MAKER)
    config = flown(by_function, Path(), tmp_path)
    section = config.steady_state
    assert with_table(by_function, tmp_path).steady_state == section
    assert (section.kind, section.source) == ("table", str(tmp_path / TABLE))
    assert config.logs.folder == str(tmp_path)
    assert section.inputs == ("TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach")
    names = (section.inputs, config.narx.outputs)
    table = open_steady(section.kind, section.source, names)
    draw = np.random.default_rng(0)
    at = draw.uniform([5, 0, 0.2, -20], [80, 35_000, 0.8, 15], (200, 4))
    switches = draw.integers(0, 2, (200, 2)).astype(float)
    bleed = np.tile([1.0, 0.0, 0.0], (200, 1))
    exact = maker_model(np.hstack([at, switches, bleed]))
    error = np.abs(table.outputs(np.hstack([at, switches])) - exact).max(axis=0)
    assert (error < [0.5, 0.7, 8.7]).all(), error  # 1.5 times those of these points


def test_an_input_without_nodes_is_named(tmp_path, make_config):
    config = make_config("elsewhere", steady_state=MAKER)
    inputs = (*config.steady_state.inputs, "FF_kgph")
    steady = config.steady_state.model_copy(update={"inputs": inputs})
    with pytest.raises(ConfigError, match=r"FF_kgph.*virtual flights do not have.*--data"):
        flown(config.model_copy(update={"steady_state": steady}), Path(), tmp_path)
