"""An emulator comes back from its folder to the bit; a damaged one is refused."""

import numpy as np
import pytest

from eval.diagnosis.applied import read_emulator, write_emulator
from narxcal.support.errors import ModelError
from training.diagnosis.emulator import fit_emulators


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return tmp_path_factory.mktemp("emulator")


@pytest.fixture(scope="module")
def emulator(stored, flights_of_the_engine):
    made = fit_emulators(flights_of_the_engine)[0]
    write_emulator(stored, made)
    return made


def test_runs_are_the_same_to_the_bit(stored, emulator, flights_of_the_engine):
    again, flights = read_emulator(stored), flights_of_the_engine
    np.testing.assert_array_equal(again.free_run(flights), emulator.free_run(flights))


def test_damage_is_refused(stored, emulator, tmp_path):
    with pytest.raises(ModelError, match="cannot be read"):
        read_emulator(tmp_path)
    (tmp_path / "emulator.json").write_text("{}", "utf-8")
    with pytest.raises(ModelError, match=r"expected schema 'narxcal\.emulator/4', found None"):
        read_emulator(tmp_path)
    text = (stored / "emulator.json").read_text("utf-8")
    (tmp_path / "emulator.json").write_text(text, "utf-8")
    with pytest.raises(ModelError, match="the weights are missing"):
        read_emulator(tmp_path)
    weights = (stored / "weights.safetensors").read_bytes()
    (tmp_path / "weights.safetensors").write_bytes(weights[:-1])
    with pytest.raises(ModelError, match="altered or cut off"):
        read_emulator(tmp_path)
    (tmp_path / "weights.safetensors").write_bytes(weights)
    (tmp_path / "emulator.json").write_text(text.replace('"switches"', '"other"'), "utf-8")
    with pytest.raises(ModelError, match="the stored emulator has no 'switches'"):
        read_emulator(tmp_path)
