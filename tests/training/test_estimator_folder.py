"""A trained `Narx` written to a folder and read again."""

import json
import re

import numpy as np
import pytest
from sklearn.base import clone

from narxcal import Narx, NarxConfig
from narxcal.calibration.folder import seal
from narxcal.support.errors import ConfigError, ModelError
from training.config import TrainConfig

QUICK = TrainConfig(horizons_s=(20.0, 0.0), iterations=(2, 3), score_every_s=1.0, threads=1)
AGAIN = "Copy the folder again, or train anew"


@pytest.fixture
def trained(lag_record):
    return Narx(NarxConfig(lags=2, taps=(0, 2), hidden=3), QUICK).fit([lag_record(0)])


@pytest.fixture
def saved(trained, tmp_path):
    trained.save(tmp_path / "model")
    return tmp_path / "model"


def refused(folder, message):
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        Narx.load(folder)


def test_what_was_saved_computes_the_same_to_the_last_bit(trained, saved, lag_record):
    loaded, unseen = Narx.load(saved), lag_record(5)
    assert (
        loaded.simulate(unseen.u, unseen.y[:3]) == trained.simulate(unseen.u, unseen.y[:3])
    ).all()
    steps = [model.predict(unseen.u, unseen.y) for model in (loaded, trained)]
    assert np.array_equal(*steps, equal_nan=True)
    assert loaded.score([unseen]) == trained.score([unseen])


def test_parameters_and_the_way_of_the_training_come_back(trained, saved):
    loaded = Narx.load(saved)
    assert loaded.get_params() == trained.get_params()
    assert loaded.result_.status == trained.result_.status
    assert loaded.result_.score == trained.result_.score
    assert str(loaded.result_.history) == str(trained.result_.history)  # NaN is not equal to NaN
    fresh = clone(loaded).set_params(structure__hidden=4)
    assert fresh.structure == NarxConfig(lags=2, taps=(0, 2), hidden=4)
    assert not hasattr(fresh, "result_")


def test_defaults_stay_defaults_and_a_subclass_stays_one(trained, tmp_path):
    class Own(Narx):
        pass

    plain = Own()
    plain.result_ = trained.result_
    plain.save(tmp_path / "model")
    loaded = Own.load(tmp_path / "model")
    assert type(loaded) is Own
    assert (loaded.structure, loaded.train, loaded.dt_s) == ("auto", None, 1.0)


def test_a_loaded_model_can_be_saved_again_to_the_same_bytes(saved, tmp_path):
    Narx.load(saved).save(tmp_path / "again")
    for name in ("narx.json", "weights.safetensors"):
        assert (tmp_path / "again" / name).read_bytes() == (saved / name).read_bytes()
    assert {file.name for file in saved.iterdir()} == {"narx.json", "weights.safetensors"}


def test_a_folder_that_stands_is_replaced_only_when_asked_and_ours(trained, saved, tmp_path):
    full = f"output folder {saved} exists and is not empty. Choose another name, or allow it to be "
    with pytest.raises(ConfigError, match=f"^{re.escape(full)}overwritten$"):
        trained.save(saved)
    trained.save(saved, replace=True)
    Narx.load(saved)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").touch()
    with pytest.raises(ConfigError, match="holds other content"):
        trained.save(tmp_path / "other", replace=True)


def test_an_untrained_one_is_not_saved(tmp_path):
    with pytest.raises(ModelError) as caught:
        Narx().save(tmp_path / "model")
    assert str(caught.value) == "the NARX network is not trained yet. Call fit first"
    assert not (tmp_path / "model").exists()


def test_folders_of_something_else_are_refused(saved, tmp_path):
    file, named = saved / "narx.json", "Name the folder that Narx.save wrote"
    refused(
        tmp_path / "no",
        f"{tmp_path / 'no'}: the stored Narx folder does not exist. Train one first",
    )
    refused(file, f"{file}: a stored Narx is a folder, and this is a file. {named}")
    words = "the folder holds no narx.json, so it is no stored Narx"
    refused(tmp_path, f"{tmp_path}: {words}. {named}")
    file.write_text('{"schema": "narxcal.bundle/1"}', encoding="utf-8")
    refused(
        saved,
        f"{file}: unknown schema 'narxcal.bundle/1', expected 'narxcal.narx/1'. "
        "Train it anew, or read it with the version of narxcal that wrote it",
    )
    file.write_text("{", encoding="utf-8")
    with pytest.raises(ModelError, match=rf"^{re.escape(str(file))}: not JSON: .*\. {AGAIN}$"):
        Narx.load(saved)


def altered(folder, change):
    file = folder / "narx.json"
    document = json.loads(file.read_text("utf-8"))
    change(document)
    file.write_text(json.dumps(document), encoding="utf-8")
    return file


def test_damage_and_changes_by_hand_are_refused(saved):
    weights = saved / "weights.safetensors"
    whole = weights.read_bytes()
    weights.write_bytes(whole[:-8])
    with pytest.raises(ModelError, match="the weights were altered or cut off: sha256 is"):
        Narx.load(saved)
    weights.unlink()
    refused(saved, f"{weights}: the weights are missing. {AGAIN}")
    weights.write_bytes(whole)
    file = altered(saved, lambda document: document["network"]["config"].update(lags=1))
    refused(saved, f"{file}: parameters, network or result were altered. {AGAIN}")
    altered(saved, lambda document: document.pop("result"))
    refused(saved, f"{file}: 'result' is missing. {AGAIN}")


def test_a_part_of_another_version_is_told_and_no_key_error(saved):
    def change(document):
        del document["parameters"]["train"]
        document["sha256"] = seal({k: document[k] for k in ("parameters", "network", "result")})

    file = altered(saved, change)
    refused(saved, f"{file}: a part cannot be read: 'train'. {AGAIN}")
