"""The documents name what the code has, and what they name exists."""

import doctest
import re
import shlex
from pathlib import Path
from typing import get_args

import pytest

from eval.run_logs import EvaluateConfig
from narxcal.cli.app import COMMANDS, parse
from narxcal.support.settings import Section
from training.config import RunConfig

ROOT = Path(__file__).parents[1]
TUTORIALS = sorted(f"docs/tutorials/{path.name}" for path in (ROOT / "docs/tutorials").glob("*.md"))
PAGES = (
    "README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
    *TUTORIALS,
)


def text(name):
    return (ROOT / name).read_text("utf-8")


def sections_in(annotation):
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return [annotation]
    return [found for part in get_args(annotation) for found in sections_in(part)]


def keys(section, table):
    for name, field in section.model_fields.items():
        key = field.alias or name
        yield table, key
        for nested in sections_in(field.annotation):
            yield from keys(nested, f"{table}.{key}".lstrip("."))


def chapter(table):
    """The part of the page on a top-level table; the whole page for keys outside tables."""
    if not table:
        return text("docs/configuration.md")
    first = table.split(".")[0]
    found = re.search(
        rf"^## \[{first}\].*?(?=^## |\Z)", text("docs/configuration.md"), re.MULTILINE | re.DOTALL
    )
    assert found, f"docs/configuration.md has no chapter on [{first}]"
    return found[0]


KEYS = sorted({*keys(RunConfig, ""), *keys(EvaluateConfig, "evaluate")})


def test_keys_are_found_in_nested_tables():
    assert ("evaluate.trim.priors", "width") in KEYS
    assert ("logs.derive.WOW", "below_kt") in KEYS
    assert len(KEYS) > 100


@pytest.mark.parametrize(("table", "key"), KEYS)
def test_every_key_is_described(table, key):
    if table == "train.still":
        assert "keys as in [quasi_steady]" in chapter(table)
    elif (
        not table
        and key in RunConfig.model_fields
        and sections_in(RunConfig.model_fields[key].annotation)
    ) or (table, key) == ("", "evaluate"):
        assert chapter(key)
    elif (table, key) == ("", "schema"):
        assert "`schema = " in chapter(table)
    else:
        assert f"`{key}`" in chapter(table)


PLAIN = re.compile(r"^\| `(\w+)` \| (-?[\d.e-]+|true|false) \|", re.MULTILINE)


def test_plain_defaults_are_those_of_the_code():
    checked = 0
    for name, field in RunConfig.model_fields.items():
        for section in sections_in(field.annotation):
            for key, said in PLAIN.findall(chapter(name)):
                if key in section.model_fields:
                    default = section.model_fields[key].default
                    assert str(default).lower() == said or default == float(said), key
                    checked += 1
    assert checked > 30


def test_every_room_is_on_the_page_of_the_layout():
    page = text("docs/architecture.md")
    for top in ("narxcal", "data_prep", "training", "eval"):
        for folder in {file.parent.relative_to(ROOT) for file in (ROOT / top).rglob("*.py")}:
            found = (f"`{folder.as_posix()}/`", f"`{folder.parent.as_posix()}/`")
            assert any(each in page for each in found), folder


def test_examples_of_the_layout_run():
    failed, run = doctest.testfile(str(ROOT / "docs/architecture.md"), module_relative=False)
    assert (failed, run > 0) == (0, True)


@pytest.mark.parametrize("page", PAGES)
def test_links_between_pages_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", text(page)):
        assert ((ROOT / page).parent / target).exists(), target


def test_the_site_has_every_page_once():
    trees = re.findall(
        r"^```\{toctree\}\n(.*?)^```", text("docs/index.md"), re.MULTILINE | re.DOTALL
    )
    listed = [line for tree in trees for line in tree.splitlines() if line and line[0] != ":"]
    there = [name.removeprefix("docs/").removesuffix(".md") for name in PAGES if "docs/" in name]
    assert sorted(listed) == sorted(set(there) - {"index"})


@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_is_run_and_can_be_taken_along(page):
    whole = text(page)
    assert whole.startswith("---\nfile_format: mystnb\n")
    assert f"{{nb-download}}`{Path(page).stem}.ipynb`" in whole
    commands = re.findall(r"^narxcal .*$", whole, re.MULTILINE)
    cells = "".join(
        re.findall(r"^```\{code-cell\}\n%%sh -e\n(.*?)^```", whole, re.MULTILINE | re.DOTALL)
    )
    assert all(line in cells for line in commands), "only a cell of `%%sh -e` stops at an error"
    for line in commands:
        words = shlex.split(line.split(" || ")[0].split(" > ")[0])
        assert parse(words[1:]).command == words[1]


ROOMS = "narxcal|training|eval|data_prep|tests"
FILE = re.compile(rf"`((?:{ROOMS})/[\w/]+(?:\.py)?)/?`")
DOTTED = re.compile(rf"\b((?:{ROOMS})(?:\.[a-z_]\w*)+)\b(?!/\d)")  # a schema ends in a version


def is_there(name):
    """Whether a file, folder or module exists, or the last part is a name in such a module."""
    path = ROOT / name
    if path.exists() or path.with_suffix(".py").exists():
        return True
    module = path.parent / "__init__.py" if path.parent.is_dir() else path.parent.with_suffix(".py")
    return module.is_file() and path.name in module.read_text("utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_files_and_modules_that_a_page_names_exist(page):
    named = {*FILE.findall(text(page))}
    named |= {name.replace(".", "/") for name in DOTTED.findall(text(page))}
    assert [name for name in sorted(named) if not is_there(name)] == []


def test_every_command_is_in_the_readme():
    readme = text("README.md")
    for command in COMMANDS:
        assert re.search(rf"narxcal {command}\b|`{command}`", readme), command


EXAMPLES = [
    (page, line.strip())
    for page in PAGES
    for line in text(page).splitlines()
    if re.match(r"(    |\$ )narxcal [a-z]", line)
]


@pytest.mark.parametrize(("page", "line"), EXAMPLES)
def test_every_command_line_that_is_shown_can_be_typed(page, line):
    words = shlex.split(line.removeprefix("$ "), comments=True)
    assert parse(words[1:]).command == words[1], page


def test_command_lines_are_found_on_many_pages():
    assert len({page for page, _ in EXAMPLES}) >= 5
