"""Precompiling: its smallest inputs are good enough for every command."""

import pytest

from narxcal.cli import precompile


@pytest.mark.slow
@pytest.mark.parametrize("task", precompile.TASKS)
def test_every_task_ends_well_and_without_a_word(task, capfd):
    assert precompile.run_task(task) == 0
    assert capfd.readouterr() == ("", "")


def test_what_fails_is_said(monkeypatch, capsys):
    monkeypatch.setattr(precompile, "_FLIGHT", "flights = 0")
    assert precompile.run_task("fly") == 2
    assert "fly.toml" in capsys.readouterr().err


def test_tasks_are_named_or_all(capsys):
    assert precompile.parsed([]) == [*precompile.TASKS]
    assert precompile.parsed(["fly"]) == ["fly"]
    with pytest.raises(SystemExit):
        precompile.parsed(["flie"])
    assert "there is no task flie; tasks are diagnose, train, fly" in capsys.readouterr().err
