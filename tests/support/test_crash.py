"""A writer that is killed at any file event leaves the former output or the new one."""

import json

import numpy as np
import pytest

from narxcal.calibration import bundle as module
from narxcal.calibration.bundle import Bundle, load_bundle, write_bundle
from narxcal.cli.app import locked
from narxcal.support.files import (
    Results,
    atomic_stream,
    atomic_write_bytes,
    check_file,
)
from tests.crash import killed_everywhere
from tests.narxcal.calibration.test_bundle import Calibration

RESULTS = Results("narxcal.evaluate/1", "evaluate.json", ("page.html",))
HOW = pytest.mark.parametrize("power", [False, True])


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    """What is put right between two kills need not be flushed to the real disk."""
    monkeypatch.setattr("os.fsync", lambda _: None)


def names(folder):
    return sorted(item.name for item in folder.iterdir())


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def write_folder(folder, text):
    """As commands write their results: a document, a page, and pages below."""
    with RESULTS.writing(folder) as part:
        (part / "evaluate.json").write_text(json.dumps({"schema": RESULTS.schema, "text": text}))
        (part / "page.html").write_text(text * 5000)


@HOW
def test_a_folder_of_results(tmp_path, power):
    out = tmp_path / "out"
    write_folder(out, "a")
    former = content(out)
    kills, seen = 0, set()
    for event in killed_everywhere(tmp_path, lambda: write_folder(out, "b"), power=power):
        RESULTS.check(out)  # as the next command does first
        assert names(tmp_path) == ["out"]
        found = json.loads((out / "evaluate.json").read_text())["text"]
        seen.add(found)
        assert (out / "page.html").read_text() == found * 5000
        if found == "b" and event is not None:
            write_folder(out, "a")
        assert content(out) == former or event is None
        kills += event is not None
    assert seen == {"a", "b"}
    assert kills >= 11


@HOW
def test_a_new_folder(tmp_path, power):
    out = tmp_path / "deep" / "out"
    for event in killed_everywhere(tmp_path, lambda: write_folder(out, "b"), power=power):
        RESULTS.check(out)
        if out.exists():
            assert names(out.parent) == ["out"]
            assert (out / "page.html").read_text() == "b" * 5000
        assert event is not None or out.exists()


@HOW
@pytest.mark.parametrize("kind", ["bytes", "stream"])
def test_a_file(tmp_path, kind, power):
    out = tmp_path / "rows.csv"
    out.write_bytes(b"a" * 5000)

    def write():
        check_file(out, overwrite=True)
        if kind == "bytes":
            atomic_write_bytes(out, b"b" * 5000)
            return
        with atomic_stream(out) as stream:
            for _ in range(50):
                stream.write("b" * 100)

    seen = set()
    for _ in killed_everywhere(tmp_path, write, power=power):
        check_file(out, overwrite=True)
        assert names(tmp_path) == ["rows.csv"]
        seen.add(out.read_bytes())
        out.write_bytes(b"a" * 5000)
    assert seen == {b"a" * 5000, b"b" * 5000}


class Deck:
    """A steady-state model with a file of its own, which travels with the bundle."""

    def __init__(self, file):
        self.file = file

    def files(self):
        return (str(self.file),)


def bundle_of(number, deck):
    return Bundle(Calibration({"number": number}, {"narx/weight": number * deck.size}, deck))


@HOW
@pytest.mark.parametrize("former", [False, True])
def test_a_bundle_in_its_run_folder(tmp_path, monkeypatch, former, power):
    """`train` writes into the run folder, next to its checkpoints."""
    monkeypatch.setattr(module, "calibration_from_arrays", Calibration.from_arrays)
    deck = Deck(tmp_path / "deck.fmu")
    deck.size = np.ones(300)
    deck.file.write_bytes(b"binary" * 500)
    run = tmp_path / "run"

    def reset():
        for path in sorted(run.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        run.mkdir(exist_ok=True)
        if former:
            write_bundle(run, bundle_of(1, deck))

    def write():
        with locked(run):
            write_bundle(run, bundle_of(2, deck))

    reset()
    seen = set()
    for event in killed_everywhere(tmp_path, write, power=power):
        if former or (run / "bundle.json").exists():
            seen.add(load_bundle(run).calibration.meta["number"])
        if event is not None:
            write()  # as --resume does
        assert load_bundle(run).calibration.meta["number"] == 2
        assert names(run) == ["bundle.json", "steady", "weights.safetensors"]
        assert names(tmp_path) == ["deck.fmu", "run"]
        if event is not None:
            reset()
    assert seen == ({1, 2} if former else {2})
