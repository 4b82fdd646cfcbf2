"""Any order of training, killing, resuming, evaluating and damaging: no result is ever lost.

A run is whole (it loads, and is the model that was written there last), or it is refused by name.
"""

import json
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from narxcal.calibration.bundle import load_bundle, save_bundle
from narxcal.cli import evaluate, main
from narxcal.support.errors import ConfigError, ModelError
from tests.crash import Disk, Killed, watched

RUNS = st.sampled_from(["a", "b"])
KILL = st.none() | st.integers(0, 50)  # at which file event the writer is killed, if at all
FILES = st.sampled_from(["bundle.json", "weights.safetensors"])


class Runs(RuleBasedStateMachine):
    """What should be on the disk: per run the seeds that its model may have, and its results'."""

    training, trained = (), None  # the words of `train`, and a model

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.seeds, self.results, self.damaged = {}, {}, {}
        self.number = 0
        evaluate.report = self.judged

    def teardown(self):
        shutil.rmtree(self.folder)

    def judged(self, *_):
        document = {"schema": "narxcal.evaluate/1", "number": self.number}
        outcome = type("Outcome", (), {"exit_code": 0})
        found = type("Judgement", (), {"outcome": outcome})
        return found, document, f"<p>{self.number}</p>"

    def attempt(self, work, kill_at):
        """Run `work`; returns its exit code, or None where it was killed before its end."""
        self.number += 1
        try:
            with watched(Disk(self.folder, kill_at)):
                return work()
        except Killed:
            return None

    def run(self, *words):
        return main([*map(str, words), "--quiet"])

    @rule(name=RUNS, kill_at=KILL, resume=st.booleans())
    def train(self, name, kill_at, resume):
        words = [*self.training, self.folder / name, *(["--resume"] if resume else [])]
        before = (self.folder / name).exists() and any((self.folder / name).iterdir())
        code = self.attempt(lambda: self.run(*words), kill_at)
        seeds = self.seeds.get(name, set())
        if name in self.damaged or (before and not resume):
            assert code in {2, None}
        elif code is None:
            self.seeds[name] = seeds or {None, 0}
        elif seeds <= {None, 0}:
            assert code == 0
            self.seeds[name] = {0}

    @rule(name=RUNS, kill_at=KILL, seed=st.integers(1, 9))
    def overwrite(self, name, kill_at, seed):
        """As Python users do; what is damaged or empty may be replaced, too."""
        other = replace(self.trained, record=self.trained.record.having(seeds=[seed]))
        run = self.folder / name
        whole = (run / "bundle.json").is_file()
        if not whole:
            return
        try:
            code = self.attempt(lambda: save_bundle(run, other, replace=True) or 0, kill_at)
        except ConfigError:  # it holds results, or by a damaged schema does not show to be ours
            assert name in self.results or self.damaged[name][0].name == "bundle.json"
            return
        former = self.seeds.get(name, {None})
        if code == 0 or not former:
            self.damaged.pop(name, None)
        self.seeds[name] = {seed} if code == 0 else {*former, seed}
        if code == 0 or name in self.results:
            left = self.results.pop(name, set())
            self.results |= {name: {None, *left}} if code is None else {}

    @rule(name=RUNS, kill_at=KILL)
    def evaluate(self, name, kill_at):
        run = self.folder / name
        code = self.attempt(lambda: self.run("evaluate", run), kill_at)
        if name in self.damaged or self.seeds.get(name, {None}) == {None}:
            assert code in {2, None}
        elif code is None:
            self.results[name] = {*self.results.get(name, {None}), self.number}
        elif code == 0:
            self.results[name] = {self.number}

    @rule(name=RUNS, file=FILES, place=st.floats(0.0, 0.999), bit=st.integers(0, 7))
    def damage(self, name, file, place, bit):
        path = self.folder / name / file
        if name in self.damaged or not path.is_file() or None in self.seeds.get(name, {None}):
            return
        self.damaged[name] = (path, path.read_bytes())
        data = bytearray(path.read_bytes())
        data[int(place * len(data))] ^= 1 << bit
        path.write_bytes(bytes(data))

    @rule(name=RUNS)
    def restore(self, name):
        if name in self.damaged:
            path, data = self.damaged.pop(name)
            path.write_bytes(data)

    @invariant()
    def every_model_is_whole_or_refused(self):
        for name, seeds in self.seeds.items():
            run = self.folder / name
            if name in self.damaged:
                with pytest.raises(ModelError):
                    load_bundle(run)
            elif (run / "bundle.json").exists():
                found = list(load_bundle(run).record.seeds)
                assert found[0] in seeds
                self.seeds[name] = {found[0]}
            else:
                assert None in seeds

    @invariant()
    def no_results_are_lost(self):
        for name, numbers in self.results.items():
            file = self.folder / name / "evaluate" / "evaluate.json"
            if not file.exists():
                assert None in numbers
                continue
            number = json.loads(file.read_text(encoding="utf-8"))["number"]
            assert number in numbers
            page = file.with_name("evaluate.html").read_text(encoding="utf-8")
            assert page == f"<p>{number}</p>"
            self.results[name] = {number}


@pytest.mark.slow
def test_runs_in_any_order(training, project, monkeypatch, capsys):
    monkeypatch.setattr("os.fsync", lambda _: None)
    monkeypatch.setattr(evaluate, "report", evaluate.report)  # put back at the end
    monkeypatch.setattr(evaluate, "show", lambda *_: None)
    monkeypatch.setattr(evaluate, "logs_for", lambda *_: [])
    trained = load_bundle(project / "run")
    machine = type("Machine", (Runs,), {"training": training, "trained": trained})
    budget = settings(
        max_examples=25,
        stateful_step_count=20,
        deadline=None,
        derandomize=True,
        phases=[Phase.generate],  # shrinking takes minutes
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(machine, settings=budget)
    capsys.readouterr()
