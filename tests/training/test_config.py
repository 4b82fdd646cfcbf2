"""The configuration file: shipped ones load, wrong ones are explained, none ends in a trace."""

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.support.errors import ConfigError
from training.config import RunConfig, load_config

ROOT = Path(__file__).parents[2]
SHIPPED = sorted(
    file.name for file in (ROOT / "configs").glob("*.toml") if not file.name.startswith("fly_")
)
TOO_LONG = "key 'name': Input should be a valid string, found a number too long to print"
HEAD = "schema = 'narxcal.config/1'\n"


def refused(file, content=None):
    if content is not None:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ConfigError) as error:
        load_config(file)
    return str(error.value)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_configurations_load_by_path_and_by_name(name):
    config, base = load_config(ROOT / "configs" / name)
    assert base == ROOT / "configs"
    for alias in (name, name.removesuffix(".toml")):
        assert load_config(alias) == (config, base)
    assert RunConfig.parse(config.model_dump(mode="json", by_alias=True)) == config


def test_a_file_of_the_schema_alone_is_enough(tmp_path):
    file = tmp_path / "run.toml"
    file.write_text(HEAD, "utf-8")
    assert load_config(str(file)) == (RunConfig(), tmp_path.resolve())


def test_defaults_go_by_whether_there_are_lags_in_front_of_the_network():
    behind, alone = RunConfig(), RunConfig.parse({"narx": {"lag": False}})
    assert (behind.narx.lag, behind.narx.lags, behind.narx.linear_feedback) == (True, 1, True)
    assert (alone.narx.lag, alone.narx.lags, alone.narx.linear_feedback) == (False, 2, False)
    assert (behind.train.decay, alone.train.decay) == (0.03, 1e-5)
    assert RunConfig.parse({"narx": {"anchored": False}}).narx == alone.narx.model_copy(
        update={"anchored": False}
    )
    own = RunConfig.parse({"narx": {"lags": 3}, "train": {"decay": 0.5}})
    assert (own.narx.lags, own.train.decay) == (3, 0.5)


def test_the_usual_schedule_is_of_what_the_inputs_have():
    bench = RunConfig.parse({"steady_state": {"inputs": ["TRA_deg"]}})
    assert bench.narx.schedule == ()
    assert RunConfig().narx.schedule == ("ALT_ft", "Mach")


def test_a_missing_file_names_the_shipped_ones(tmp_path):
    assert refused(tmp_path / "no.toml") == (
        f"{tmp_path / 'no.toml'}: the configuration does not exist. "
        f"Name a file, or one of the shipped {', '.join(SHIPPED)}"
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected schema = 'narxcal.config/1', found nothing. Write it as the first line"),
        (
            "schema = 'narxcal.config/2'",
            (
                "expected schema = 'narxcal.config/1', found 'narxcal.config/2'. "
                "Write it as the first line"
            ),
        ),
        (
            HEAD + "[train]\nhorizon_s = [1.0]",
            "unknown key 'train.horizon_s'. Did you mean 'horizons_s'?",
        ),
        (HEAD + "[trian]", "unknown key 'trian'. Did you mean 'train'?"),
        (HEAD + "[logs]\nwindow = 5", "unknown key 'logs.window'. It is a key of [smooth]"),
        (HEAD + "folder = 'logs'", "unknown key 'folder'. It is a key of [logs]"),
        (
            HEAD + "[logs]\nrecovery = 0.9",
            "unknown key 'logs.recovery'. It is a key of [logs.derive]",
        ),
        (
            HEAD + "[narx]\nseed = 1\nwindow_s = 1.0",
            "unknown key 'narx.seed'. It is a key of [train]",
        ),
        (
            HEAD + "[split]\nwindow_s = 2.0",
            (
                "unknown key 'split.window_s'. It is a key of [events] and of [quasi_steady] "
                "and of [train.still]"
            ),
        ),
        (
            HEAD + "[split]\nfoo = 2.0",
            "unknown key 'split.foo'. Known keys: test, train, validate",
        ),
        (HEAD + "[logs]\nfiles = '*.csv'", "key 'logs.files': expected a list, found '*.csv'"),
        (
            HEAD + "[logs]\nfiles = ['/data/*.csv']",
            (
                "key 'logs.files': expected patterns of files below [logs] folder, without its "
                "path, found ['/data/*.csv']"
            ),
        ),
        (
            HEAD + "[narx]\noutputs = []",
            "key 'narx.outputs': expected a list of at least 1, found []",
        ),
        (
            HEAD + "[narx]\noutputs = ['N1_pct', 'N1_pct']",
            "key 'narx.outputs': 'N1_pct' is named twice, found ['N1_pct', 'N1_pct']",
        ),
        (
            HEAD + "[narx]\noutputs = ['N1_pct', 'Mach']",
            (
                "'Mach' is an output in [narx] and an input in [steady_state]. "
                "Remove it from one of them"
            ),
        ),
        (
            HEAD + "[steady_state]\ninputs = ['TRA']",
            "unknown channel 'TRA'. Did you mean 'TRA_deg'?",
        ),
        (
            HEAD + "[steady_state]\ninputs = []",
            "key 'steady_state.inputs': expected a list of at least 1, found []",
        ),
        (
            HEAD + "[train]\niterations = [1]",
            "key 'train': horizons_s and iterations have to be of one length, found 2 and 1",
        ),
        (
            HEAD + "[narx]\nlags = 0",
            "key 'narx.lags': Input should be greater than or equal to 1, found 0",
        ),
        (
            HEAD + "[train]\nseed = -1",
            "key 'train.seed': Input should be greater than or equal to 0, found -1",
        ),
        (
            HEAD + "[narx]\ntaps = [1, 0]",
            (
                "key 'narx.taps': has to list increasing delays >= 0, for example "
                "[0, 1], found [1, 0]"
            ),
        ),
        (
            HEAD + "[narx]\noutputs = ['N3_pct']",
            (
                "unknown channel 'N3_pct'. Did you mean 'N2_pct'? Or declare it: [logs.channels] "
                "N3_pct = { range = [0, 100] }"
            ),
        ),
        (
            HEAD + "[narx]\nschedule = ['WOW']",
            (
                "[narx] schedule names 'WOW', which is not in [steady_state] inputs. "
                "Inputs are TRA_deg, ALT_ft, Mach, dT_C"
            ),
        ),
        (
            HEAD + "[events]\ndriver = 'FF_kgph'",
            (
                "[events] driver names 'FF_kgph', which is not in [steady_state] inputs. "
                "Inputs are TRA_deg, ALT_ft, Mach, dT_C"
            ),
        ),
        (
            HEAD + "[train]\nhorizons_s = [-1.0]\niterations = [1]",
            "key 'train.horizons_s.0': Input should be greater than or equal to 0, found -1.0",
        ),
        (HEAD + "seed = " + "9" * 5000, None),
        (HEAD + "name = " + "[" * 5000, None),
        (b"\xff\xfe", "expected a TOML file, found no text in UTF-8"),
        (HEAD + "name = 0x" + "f" * 5000, TOO_LONG),
        ("name = ", None),
    ],
)
def test_what_is_wrong_is_said(content, message, tmp_path):
    file = tmp_path / "run.toml"
    found = refused(file, content)
    if message is None:
        assert found.startswith(f"{file}: not TOML: ")
    else:
        assert found == f"{file}: {message}"


SECTIONS = ("train", "narx", "steady_state", "split", "smooth", "clean", "fuser", "quasi_steady")
KEYS = sorted(
    {key for name in SECTIONS for key in type(getattr(RunConfig(), name)).model_fields} | {"hiden"}
)
values = st.one_of(
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text("xyz"),
    st.lists(st.one_of(st.integers(), st.text("xyz")), max_size=3),
    st.dictionaries(st.sampled_from(KEYS), st.integers(), max_size=2),
)


@given(content=st.one_of(st.binary(max_size=60), st.text(max_size=60).map(str.encode)))
def test_any_bytes_give_a_configuration_or_one_error(content, tmp_path_factory):
    file = tmp_path_factory.mktemp("fuzz") / "run.toml"
    for head in (b"", HEAD.encode()):
        file.write_bytes(head + content)
        with contextlib.suppress(ConfigError):
            assert isinstance(load_config(file)[0], RunConfig)


@given(
    section=st.sampled_from(SECTIONS),
    table=st.dictionaries(st.sampled_from(KEYS), values, max_size=3),
)
def test_any_table_gives_a_configuration_or_one_error(section, table):
    with contextlib.suppress(ConfigError):
        found = RunConfig.parse({"schema": "narxcal.config/1", section: table})
        assert isinstance(found, RunConfig)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (
            {"smooth": {"window": "x"}},
            "key 'smooth.window': Input should be a valid integer or 'auto', found 'x'",
        ),
        (
            {"narx": {"lag_limits": "x"}},
            "key 'narx.lag_limits': Input should be 'auto' or a valid boolean, found 'x'",
        ),
        (
            {"steady_state": {"exponents": ["x"]}},
            "key 'steady_state.exponents.0': Input should be 'theta' or 'delta', found 'x'",
        ),
    ],
)
def test_a_value_that_may_be_of_several_types_is_named_by_its_key_alone(table, said):
    with pytest.raises(ConfigError) as caught:
        RunConfig.parse(table)
    assert str(caught.value) == said
