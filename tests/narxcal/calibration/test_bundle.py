"""The bundle folder: comes back as it was, and anything else is refused by name."""

import errno
import hashlib
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from narxcal.calibration import bundle as module
from narxcal.calibration.bundle import Bundle, load_bundle, read_document, save_bundle
from narxcal.calibration.folder import seal
from narxcal.calibration.run_record import RunRecord
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import to_json

AGAIN = "Copy the bundle again, or train it anew"


class Calibration:
    """As little of a calibration as a bundle needs, so that any content can be tried."""

    input_names = ("TRA_deg", "Mach")
    output_names = ("N1_pct", "EGT_C")
    dt_s = 1 / 32

    def __init__(self, meta, arrays, steady=None):
        self.meta, self.arrays, self.steady = meta, arrays, steady

    def to_arrays(self):
        return self.meta, self.arrays

    @classmethod
    def from_arrays(cls, meta, arrays, **_):
        return cls(meta, arrays)


@pytest.fixture(autouse=True)
def _calibration(monkeypatch):
    monkeypatch.setattr(module, "calibration_from_arrays", Calibration.from_arrays)


def names(folder):
    return sorted(item.name for item in folder.iterdir())


def example(**meta):
    arrays = {"narx/weight": np.arange(6.0).reshape(2, 3), "steady/points": np.eye(2)}
    return Bundle(Calibration({"narx": {"lags": 4}}, arrays), RunRecord.parse(meta))


@pytest.fixture
def saved(tmp_path):
    save_bundle(tmp_path / "run", example(seed=7))
    return tmp_path / "run"


def refused(folder, message):
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        load_bundle(folder)


def edit(folder, **entries):
    """Change the document and give it the hash of what it says now, as an author could."""
    file = folder / "bundle.json"
    document = {**json.loads(file.read_text(encoding="utf-8")), **entries}
    document = {key: value for key, value in document.items() if key != "sha256"}
    file.write_text(to_json({**document, "sha256": seal(document)}), encoding="utf-8")


NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), min_size=1, max_size=12)
JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**53), 2**53)
    | st.text(max_size=8)
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=8,
)
ARRAYS = st.dictionaries(
    NAMES.filter(lambda name: name != "__metadata__"),
    hnp.arrays(
        st.sampled_from([np.float64, np.float32, np.int64, np.bool_]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    ),
    max_size=5,
)


@given(
    arrays=ARRAYS,
    meta=st.dictionaries(NAMES, JSON, max_size=4),
    more=st.dictionaries(NAMES.map("x-{}".format), JSON, max_size=4),
)
def test_any_arrays_and_any_json_come_back_as_they_were(tmp_path, arrays, meta, more):
    folder = tmp_path / os.urandom(8).hex()
    save_bundle(folder, Bundle(Calibration(meta, arrays), RunRecord.parse(more)))
    back = load_bundle(folder)
    assert back.calibration.meta == meta
    assert back.calibration.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        found = back.calibration.arrays[name]
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array)
    assert {key: value for key, value in back.record.to_json().items() if key != "versions"} == more


def test_the_document_says_what_is_in_the_bundle(saved):
    document = read_document(saved)
    assert document["schema"] == "narxcal.bundle/2"
    assert document["dt_s"] == 0.03125
    assert document["channels"] == {"inputs": ["TRA_deg", "Mach"], "outputs": ["N1_pct", "EGT_C"]}
    assert document["units"] == {"TRA_deg": "deg", "Mach": "-", "N1_pct": "%", "EGT_C": "degC"}
    assert document["calibration"]["narx"]["lags"] == 4
    assert (
        document["weights"]["sha256"]
        == hashlib.sha256((saved / "weights.safetensors").read_bytes()).hexdigest()
    )
    assert document["weights"]["arrays"]["narx/weight"] == {"dtype": "float64", "shape": [2, 3]}
    assert document["seed"] == 7
    assert set(document["versions"]) >= {"python", "narxcal", "numpy", "torch"}
    assert names(saved) == ["bundle.json", "weights.safetensors"]


def test_arrays_that_are_not_contiguous_come_back_whole(tmp_path):
    array = np.arange(24.0).reshape(4, 6).T[::2]
    save_bundle(tmp_path / "run", Bundle(Calibration({}, {"a": array})))
    np.testing.assert_array_equal(load_bundle(tmp_path / "run").calibration.arrays["a"], array)


def test_meta_of_numpy_paths_and_nan_becomes_plain_json(tmp_path):
    meta = {"rmse": np.float64("nan"), "seed": np.int64(3), "file": Path("a/b"), "t": (1, 2.5)}
    save_bundle(tmp_path / "run", example(metrics=meta))
    back = load_bundle(tmp_path / "run").record.to_json()["metrics"]
    assert back == {"rmse": None, "seed": 3, "file": "a/b", "t": [1, 2.5]}


@pytest.mark.parametrize(
    ("bundle", "message"),
    [
        (example(x={"y": object()}), "a value of type object cannot be stored in a bundle"),
        (example(schema=1), "the run's record may not hold 'schema', which the bundle writes"),
        (
            Bundle(Calibration({"gain": float("inf")}, {})),
            "the calibration holds a number that JSON cannot. Store it as array",
        ),
        (
            Bundle(Calibration({}, {"names": np.array(["a"])})),
            "array 'names' of type <U1 cannot be stored in a bundle",
        ),
    ],
)
def test_what_cannot_be_stored_is_refused_and_leaves_nothing(tmp_path, bundle, message):
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        save_bundle(tmp_path / "run", bundle)
    assert names(tmp_path) == []


def test_a_missing_folder_is_refused(tmp_path):
    folder = tmp_path / "none"
    refused(folder, f"{folder}: the bundle folder does not exist. Train one first")


def test_a_folder_without_document_is_no_bundle(tmp_path):
    refused(
        tmp_path,
        f"{tmp_path}: the folder holds no bundle.json, so it is no bundle. "
        "Name the folder that narxcal train wrote",
    )


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"{", "Expecting property name enclosed in double quotes: line 1 column 2 (char 1)"),
        (b"", "Expecting value: line 1 column 1 (char 0)"),
        (b"\xff", "'utf-8' codec can't decode byte 0xff in position 0: invalid start byte"),
    ],
)
def test_a_document_that_is_not_json_is_refused(saved, content, problem):
    (saved / "bundle.json").write_bytes(content)
    refused(saved, f"{saved / 'bundle.json'}: not JSON: {problem}. {AGAIN}")


@pytest.mark.parametrize("schema", ["narxcal.bundle/1", "narxcal.bundle/9", None, 3])
def test_another_schema_is_refused(saved, schema):
    edit(saved, schema=schema)
    refused(
        saved,
        f"{saved / 'bundle.json'}: unknown schema {schema!r}, expected 'narxcal.bundle/2'. "
        "Train it anew, or read it with the version of narxcal that wrote it",
    )


def test_a_document_that_is_a_list_is_refused(saved):
    (saved / "bundle.json").write_text("[]", encoding="utf-8")
    with pytest.raises(ModelError, match=r"unknown schema None, expected 'narxcal\.bundle/2'"):
        load_bundle(saved)


@pytest.mark.parametrize("key", ["weights", "calibration"])
def test_a_document_without_its_parts_is_refused(saved, key):
    edit(saved, **{key: None})
    refused(saved, f"{saved / 'bundle.json'}: '{key}' is missing. {AGAIN}")


ALTERED = "the file was altered: its content does not have the hash that it states"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"lags": 4', '"lags": 5'),
        lambda text: text.replace('"seed": 7', '"seed": 8'),
        lambda text: text.replace("degC", "degK"),
        lambda text: text.replace('"seed": 7', '"seed":  7'),
        lambda text: text.replace('"seed": 7', '"seed": 1,\n "seed": 7'),
        lambda text: text.replace("\n", "\r\n"),
    ],
    ids=["structure", "origin", "unit", "space", "twice", "line ends"],
)
def test_a_document_changed_by_hand_is_refused(saved, change):
    file = saved / "bundle.json"
    text = file.read_text(encoding="utf-8")
    assert change(text) != text
    file.write_bytes(change(text).encode())
    refused(saved, f"{file}: {ALTERED}. {AGAIN}")


def test_the_hash_of_a_loaded_bundle_is_that_of_the_document(saved):
    document = json.loads((saved / "bundle.json").read_text(encoding="utf-8"))
    assert load_bundle(saved).sha256 == document.pop("sha256")
    assert load_bundle(saved).sha256 == seal(document)


@pytest.mark.parametrize("depth", [200, 5000, 200_000])
def test_deep_nesting_is_refused(saved, depth):
    text = to_json(read_document(saved)).replace('"seed": 7', f'"seed": {"[" * depth}{"]" * depth}')
    (saved / "bundle.json").write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=rf"bundle\.json: .*{AGAIN}$"):
        load_bundle(saved)


@pytest.mark.parametrize(
    ("entries", "problem"),
    [
        ({"config": [1]}, "key 'config': expected a table of keys, found [1]"),
        ({"units": "kg"}, "'units' is no table of keys"),
        ({"files": None}, "'files' is missing"),
        ({"files": {"steady/../x": ""}}, "'steady/../x' is no file in steady/"),
        (
            {"dt_s": 2},
            "'dt_s' or 'channels' differ from those of the part 'calibration'",
        ),
        (
            {"dt_s": [1]},
            (
                "the part 'calibration' cannot be read: TypeError: float() argument must be a "
                "string or a real number, not 'list'"
            ),
        ),
    ],
)
def test_parts_of_a_wrong_type_are_refused_even_with_a_fitting_hash(saved, entries, problem):
    edit(saved, **entries)
    refused(saved, f"{saved / 'bundle.json'}: {problem}. {AGAIN}")


def test_a_number_that_json_lacks_is_refused(saved):
    text = to_json(read_document(saved)).replace('"seed": 7', '"seed": NaN')
    (saved / "bundle.json").write_text(text, encoding="utf-8")
    refused(saved, f"{saved / 'bundle.json'}: not JSON: NaN is no number in JSON. {AGAIN}")


@given(data=st.data())
def test_any_changed_byte_is_refused(saved, data):
    file = saved / data.draw(st.sampled_from(["bundle.json", "weights.safetensors"]))
    former = file.read_bytes()
    at = data.draw(st.integers(0, len(former) - 1))
    changed = bytes([data.draw(st.integers(0, 255).filter(lambda byte: byte != former[at]))])
    file.write_bytes(former[:at] + changed + former[at + 1 :])
    try:
        with pytest.raises(ModelError, match=re.escape(str(file))):
            load_bundle(saved)
    finally:
        file.write_bytes(former)


def test_missing_weights_are_refused(saved):
    (saved / "weights.safetensors").unlink()
    refused(saved, f"{saved / 'weights.safetensors'}: the weights are missing. {AGAIN}")


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data[:-5],
        lambda data: data[:-1] + b"\x01",
        lambda _: b"",
        lambda data: data * 2,
    ],
    ids=["truncated", "altered", "empty", "appended"],
)
def test_weights_that_were_cut_off_or_altered_are_refused(saved, change):
    file = saved / "weights.safetensors"
    former = hashlib.sha256(file.read_bytes()).hexdigest()
    file.write_bytes(change(file.read_bytes()))
    found = hashlib.sha256(file.read_bytes()).hexdigest()
    refused(
        saved,
        f"{file}: the weights were altered or cut off: sha256 is {found[:12]}, "
        f"bundle.json says {former[:12]}. {AGAIN}",
    )


def test_weights_in_another_format_are_refused_even_with_a_fitting_hash(saved):
    file = saved / "weights.safetensors"
    file.write_bytes(b"PK\x03\x04 a pickle in a zip")
    edit(saved, weights={"sha256": hashlib.sha256(file.read_bytes()).hexdigest()})
    with pytest.raises(ModelError, match=rf"weights\.safetensors: not safetensors: .*{AGAIN}$"):
        load_bundle(saved)


def test_a_folder_with_content_is_refused_and_a_bundle_only_replaced_on_request(saved):
    with pytest.raises(ConfigError, match="run exists and is not empty"):
        save_bundle(saved, example())
    save_bundle(saved, example(seed=8), replace=True)
    assert load_bundle(saved).record.to_json()["seed"] == 8


def test_a_full_disk_leaves_no_bundle(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ConfigError, match="cannot write: No space left on device"):
        save_bundle(tmp_path / "run", example())
    assert names(tmp_path) == []


def test_an_array_called_as_the_formats_own_header_is_refused(tmp_path):
    message = "array name '__metadata__' is the format's own"
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        save_bundle(tmp_path / "run", Bundle(Calibration({}, {"__metadata__": np.ones(1)})))


class NeedsFile(SteadyTable):
    def __init__(self, *paths):
        super().__init__((["TRA_deg"], ["N1_pct"]), [[0.0], [1.0]], [[0.0], [1.0]])
        self.paths = paths

    def files(self):
        return tuple(map(str, self.paths))


def test_a_file_of_the_steady_state_model_travels_with_the_bundle(tmp_path):
    fmu = tmp_path / "engine.fmu"
    fmu.write_bytes(b"black box")
    calibration = Calibration(
        {"steady": {"kind": "fmu", "file": str(fmu)}}, {}, NeedsFile(fmu, tmp_path / "gone")
    )
    save_bundle(tmp_path / "run", Bundle(calibration))
    fmu.unlink()
    copy = tmp_path / "run" / "steady" / "engine.fmu"
    assert copy.read_bytes() == b"black box"
    assert load_bundle(tmp_path / "run").calibration.meta["steady"]["file"] == str(copy)
    found, known = (hashlib.sha256(data).hexdigest()[:12] for data in (b"other", b"black box"))
    copy.write_bytes(b"other")
    refused(
        tmp_path / "run",
        f"{copy}: the file was altered: sha256 is {found}, bundle.json says {known}. {AGAIN}",
    )
    copy.unlink()
    refused(tmp_path / "run", f"{copy}: the file is missing. {AGAIN}")


def test_a_planted_file_of_the_same_name_is_not_used(tmp_path):
    meta = {"steady": {"kind": "callable", "file": "/home/maker.py"}}
    save_bundle(tmp_path / "run", Bundle(Calibration(meta, {})))
    (tmp_path / "run" / "steady").mkdir()
    (tmp_path / "run" / "steady" / "maker.py").write_text("raise SystemExit", encoding="utf-8")
    assert load_bundle(tmp_path / "run").calibration.meta == meta
