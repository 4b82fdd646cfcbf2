"""No name of a file commands the terminal that shows it."""

import pytest

from narxcal.cli import main
from narxcal.cli.console import Console
from narxcal.support.errors import printable

EVIL = "\x1b[2J\x1b]0;owned\x07log\x9b31m.csv"


def test_control_characters_are_spelled_out_and_other_text_stays():
    assert printable(EVIL) == "\\x1b[2J\\x1b]0;owned\\x07log\\x9b31m.csv"
    assert printable("Flug über Köln\n2 °C") == "Flug über Köln\n2 °C"
    assert printable("\u202egnp.exe") == "\\u202egnp.exe"


@pytest.mark.parametrize("command", ["evaluate", "info", "replay"])
def test_errors_and_warnings_show_names_without_commands(command, capsys):
    more = ["log.csv", "--out", "out.csv"] if command == "replay" else []
    assert main([command, EVIL, *more]) == 2
    Console().warn(EVIL)
    Console().say(EVIL)
    Console().table(EVIL, [EVIL], [[EVIL]])
    Console().page.print(EVIL)
    shown = capsys.readouterr()
    assert "\x1b" not in shown.out + shown.err
    assert "\x9b" not in shown.out + shown.err
