"""Files and folders appear whole or not at all."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from narxcal.cli.app import locked
from narxcal.support.csv_text import log_csv, text_cell
from narxcal.support.errors import ConfigError
from narxcal.support.files import (
    Results,
    atomic_folder,
    atomic_stream,
    atomic_write_bytes,
    atomic_write_text,
    check_file,
    check_output_folder,
    recover,
)

FULL = OSError(errno.ENOSPC, "No space left on device")


def disk_full(*_):
    raise FULL


def names(folder):
    return sorted(item.name for item in folder.iterdir())


def test_a_file_is_written_and_replaced_with_ordinary_permissions(tmp_path):
    file = tmp_path / "deep" / "a.txt"
    atomic_write_text(file, "first")
    atomic_write_text(file, "zweite Fassung \u00e4")
    plain = tmp_path / "plain"
    plain.write_text("x", encoding="utf-8")
    assert file.read_text(encoding="utf-8") == "zweite Fassung \u00e4"
    assert names(file.parent) == ["a.txt"]
    assert file.stat().st_mode == plain.stat().st_mode


def test_a_full_disk_keeps_the_former_file_and_leaves_nothing(tmp_path, monkeypatch):
    file = tmp_path / "a.bin"
    atomic_write_bytes(file, b"former")
    monkeypatch.setattr(os, "fsync", disk_full)
    message = (
        f"{file}: cannot write: No space left on device. "
        "Nothing was changed; free some space or choose another place"
    )
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        atomic_write_bytes(file, b"new")
    assert file.read_bytes() == b"former"
    assert names(tmp_path) == ["a.bin"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_truly_full_device_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "open", lambda *_: open("/dev/full", "wb"))  # noqa: PTH123, SIM115
    with pytest.raises(ConfigError, match="cannot write: No space left on device"):
        atomic_write_bytes(tmp_path / "a.bin", b"x" * 100_000)
    assert names(tmp_path) == []


def test_a_place_that_cannot_hold_it_is_named(tmp_path):
    (tmp_path / "file").touch()
    for write in (lambda at: atomic_write_bytes(at, b""), lambda at: atomic_folder(at).__enter__()):
        with pytest.raises(
            ConfigError, match=r"file/run: cannot write: (File exists|Not a directory)\. Nothing"
        ):
            write(tmp_path / "file" / "run")


def test_an_unreadable_input_inside_the_block_is_not_blamed_on_the_disk(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_folder(tmp_path / "run"):
        (tmp_path / "log.csv").read_text(encoding="utf-8")
    assert names(tmp_path) == []


def test_a_folder_appears_only_when_the_block_ends_well(tmp_path):
    target = tmp_path / "runs" / "one"
    with atomic_folder(target) as part:
        (part / "a").write_text("1", encoding="utf-8")
        assert not target.exists()
    assert names(target) == ["a"]
    assert names(target.parent) == ["one"]


def test_an_empty_folder_may_be_filled(tmp_path):
    (tmp_path / "run").mkdir()
    with atomic_folder(tmp_path / "run") as part:
        (part / "a").touch()
    assert names(tmp_path / "run") == ["a"]


@pytest.mark.parametrize("live", [False, True])
def test_a_stream_appears_only_when_the_block_ends_well(tmp_path, live):
    target = tmp_path / "deep" / "rows.csv"
    with atomic_stream(target, live=live) as stream:
        stream.write("a\n")
        assert not target.exists()
        assert (tmp_path / "deep" / "rows.csv.part").exists() == live
    assert target.read_bytes() == b"a\n"
    for error in (ValueError("bad"), KeyboardInterrupt()):

        def fail(error=error):
            with atomic_stream(target, live=live) as stream:
                stream.write("half")
                raise error

        with pytest.raises(type(error)):
            fail()
    message = r"rows\.csv: cannot write: No space left on device"
    with pytest.raises(ConfigError, match=message), atomic_stream(target, live=live):
        disk_full()
    assert target.read_bytes() == b"a\n"
    assert names(target.parent) == ["rows.csv"]


@pytest.mark.parametrize("error", [ValueError("bad"), KeyboardInterrupt()])
def test_any_error_removes_the_folder_and_goes_on(tmp_path, error):
    def fail():
        with atomic_folder(tmp_path / "run") as part:
            (part / "a").touch()
            raise error

    with pytest.raises(type(error)):
        fail()
    assert names(tmp_path) == []


def test_a_disk_that_fills_up_in_a_folder_leaves_nothing(tmp_path):
    def fail():
        with atomic_folder(tmp_path / "run"):
            disk_full()

    with pytest.raises(ConfigError, match="run: cannot write: No space left on device"):
        fail()
    assert names(tmp_path) == []


RUN = Results("narxcal.bundle/", "bundle.json", ("old", "new"))


def refused(path, message, replaced=RUN):
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"), atomic_folder(path, replaced):
        pass
    with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
        check_output_folder(path, replaced)


def test_a_folder_with_content_is_refused_and_untouched(tmp_path):
    (tmp_path / "thesis.tex").touch()
    refused(
        tmp_path,
        f"output folder {tmp_path} exists and is not empty. "
        "Choose another name, or allow it to be overwritten",
        None,
    )
    assert names(tmp_path) == ["thesis.tex"]


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    file = tmp_path / "run"
    file.touch()
    refused(file, f"output folder {file} is not a folder. Choose another name")


def written_run(folder):
    folder.mkdir()
    (folder / "bundle.json").write_text('{"schema": "narxcal.bundle/1"}', encoding="utf-8")
    (folder / "old").touch()
    return folder


def test_our_own_folder_is_replaced_whole_on_request(tmp_path):
    run = written_run(tmp_path / "run")
    with atomic_folder(run, RUN) as part:
        (part / "new").touch()
    assert names(run) == ["new"]
    assert names(tmp_path) == ["run"]


def test_a_failed_rename_puts_the_former_folder_back(tmp_path, monkeypatch):
    run = written_run(tmp_path / "run")
    real = Path.replace

    def replace(self, target):
        if self.name.endswith(".part"):
            raise FULL
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(ConfigError, match="cannot write"), atomic_folder(run, RUN):
        pass
    assert names(run) == ["bundle.json", "old"]
    assert names(tmp_path) == ["run"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_a_killed_run_leaves_no_folder_that_could_be_taken_for_good(tmp_path):
    code = (
        "import sys, time\n"
        "from narxcal.support.files import atomic_folder\n"
        "with atomic_folder(sys.argv[1]) as part:\n"
        "    (part / 'bundle.json').write_text('half')\n"
        "    (part.parent / 'ready').touch()\n"
        "    time.sleep(60)\n"
    )
    run = tmp_path / "run"
    with subprocess.Popen([sys.executable, "-c", code, str(run)]) as process:
        until = time.monotonic() + 30
        while not (tmp_path / "ready").exists() and time.monotonic() < until:
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
    assert (tmp_path / "ready").exists()
    assert not run.exists()
    with atomic_folder(run) as part:
        (part / "bundle.json").touch()
    assert run.exists()


@pytest.mark.parametrize("stands", [True, False])
def test_what_a_killed_process_left_is_put_right_by_the_next_command(tmp_path, stands):
    """Killed between the two renames: the former folder comes back; after them, it goes."""
    run = tmp_path / "run"
    former = written_run(tmp_path / ".run.00aa.old")
    (tmp_path / ".run.00aa.part").mkdir()
    (tmp_path / ".run.00bb.part").touch()
    if stands:
        run.mkdir()
        (run / "new").touch()
    recover(run)
    assert names(run) == (["new"] if stands else ["bundle.json", "old"])
    assert not former.exists()
    assert names(tmp_path) == ["run"]


def test_a_folder_is_written_by_one_process_at_a_time(tmp_path):
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from narxcal.cli.app import locked\n"
        "with locked(Path(sys.argv[1])):\n"
        "    print('locked', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    run = tmp_path / "run"
    command = [sys.executable, "-c", code, str(run)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as other:
        assert other.stdout.readline() == "locked\n"
        message = rf"run is being written by another command \(process {other.pid} on .*\)\. Wait"
        with pytest.raises(ConfigError, match=message), locked(run):
            pass
        other.kill()
    with locked(run):
        assert (tmp_path / ".run.lock").exists()
    assert names(tmp_path) == []


def test_devices_and_pipes_are_written_in_place(tmp_path, capsys):
    atomic_write_text(os.devnull, "a")
    assert not Path(os.devnull).is_file()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen(["cat", str(pipe)], stdout=subprocess.PIPE) as reader:
        with atomic_stream(pipe) as stream:
            stream.write("rows\n")
        assert reader.communicate()[0] == b"rows\n"
    assert names(tmp_path) == ["pipe"]
    with atomic_stream("-") as stream:
        stream.write("rows\n")
    assert capsys.readouterr().out == "rows\n"
    for out in (Path(os.devnull), pipe, Path("-")):
        check_file(out)


def test_no_file_that_exists_or_is_read_is_written_over(tmp_path):
    notes, run = tmp_path / "notes.csv", written_run(tmp_path / "run")
    notes.touch()
    with pytest.raises(ConfigError, match=r"notes\.csv exists\. Add --overwrite, or choose"):
        check_file(notes)
    check_file(notes, run, overwrite=True)
    with pytest.raises(ConfigError, match=r"notes\.csv is the input itself\. Choose another name"):
        check_file(notes, notes, overwrite=True)
    message = r"bundle\.json is part of .*run, which is read\. Choose another name"
    with pytest.raises(ConfigError, match=message):
        check_file(run / "bundle.json", run, overwrite=True)
    check_file(run / "new.csv", run)


def test_a_link_that_leads_nowhere_is_not_replaced(tmp_path):
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "gone").symlink_to(tmp_path / "unmounted" / "x.csv")
    for name in ("loop", "gone"):
        with pytest.raises(ConfigError, match=f"{name} is a link that leads nowhere"):
            check_file(tmp_path / name, overwrite=True)


@pytest.mark.parametrize(
    ("name", "what"), [("/", "is the working directory, or holds it"), (".", "is the working")]
)
def test_a_folder_that_cannot_be_exchanged_is_refused_before_the_work(
    tmp_path, monkeypatch, name, what
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=f"^output folder {re.escape(name)} {what}"):
        check_output_folder(name, RUN)
    with pytest.raises(ConfigError, match=f"^output folder {re.escape(name)} {what}"):
        Results("narxcal.x/1", "x.json", ()).check(Path(name))


def test_a_link_to_a_folder_stays_and_its_folder_is_filled(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk")
    with atomic_folder(tmp_path / "link") as part:
        (part / "a").touch()
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path / "disk") == ["a"]


def test_a_log_is_printed_as_csv_without_nan_and_minus_zero():
    text = log_csv({"time_s": [0.1, 0.30000000000000004], "N1_pct": [float("nan"), -0.0]})
    assert text == "time_s,N1_pct\n0.1,\n0.3,0\n"


@pytest.mark.parametrize(("name", "cell"), [("=1+1", "'=1+1"), ("@x", "'@x"), ("a-b", "a-b")])
def test_no_name_is_a_formula_in_a_spreadsheet(name, cell):
    assert text_cell(name) == cell
