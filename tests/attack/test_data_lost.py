"""What is not narxcal's stays, and of commands that write one output one writes."""

import pytest

from narxcal.cli import main
from narxcal.cli.app import locked
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results, atomic_folder

RUN = Results("narxcal.x/", "x.json", ("arrays", "steady/*"))


def stored(folder):
    with atomic_folder(folder) as part:
        (part / "x.json").write_text('{"schema": "narxcal.x/1"}', encoding="utf-8")
        (part / "arrays").touch()
        (part / "steady").mkdir()
        (part / "steady" / "engine.fmu").touch()
    return folder


@pytest.mark.parametrize("foreign", ["thesis.tex", "flights/1.csv", "steady/logs/1.csv"])
def test_a_folder_is_replaced_only_where_it_holds_nothing_else(tmp_path, foreign):
    run = stored(tmp_path / "run")
    with atomic_folder(run, RUN) as part:
        (part / "x.json").write_text('{"schema": "narxcal.x/1"}', encoding="utf-8")
    stored(tmp_path / "other")
    file = tmp_path / "other" / foreign
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("years of work", encoding="utf-8")
    message = "holds other content \\('.*'\\) and is not overwritten"
    with pytest.raises(ConfigError, match=message), atomic_folder(tmp_path / "other", RUN):
        pass
    assert file.read_text(encoding="utf-8") == "years of work"


def test_the_json_of_another_command_makes_no_folder_ours(tmp_path):
    (tmp_path / "gap.json").write_text('{"schema": "narxcal.gap/2"}', encoding="utf-8")
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ConfigError, match="is not overwritten"), atomic_folder(tmp_path, RUN):
        pass
    assert sorted(each.name for each in tmp_path.iterdir()) == ["gap.json", "thesis.tex"]


def test_one_command_at_a_time_writes_an_output_and_others_fail_before_the_work(tmp_path, capsys):
    out = tmp_path / "deep" / "out.csv"
    words = ["replay", "no_run", "no_log.csv", "--out", str(out)]
    with locked(out):
        assert main(words) == 2
        assert f"{out} is being written by another command" in capsys.readouterr().err
    assert main(words) == 2
    assert "being written" not in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["evaluate", "replay"])
def test_a_link_in_a_circle_fails_before_the_work(tmp_path, command, capsys):
    (tmp_path / "loop").symlink_to("loop")
    more = ["log.csv"] if command == "replay" else []
    assert main([command, "no_run", *more, "--out", str(tmp_path / "loop")]) == 2
    assert "is a link that leads nowhere" in capsys.readouterr().err
