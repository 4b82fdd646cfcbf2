"""A name that no file system takes is a missing file, wherever it stands."""

import pytest

from data_prep.config import LogsConfig
from narxcal import load_bundle
from narxcal.flight_test.fly import load_scenario
from narxcal.steady.fmu import read_description
from narxcal.steady.table import read_steady_table
from narxcal.support.errors import NarxcalError
from training.config import load_config

LONG = "x" * 5000


@pytest.mark.parametrize(
    "opened",
    [
        lambda folder: LogsConfig.parse({"folder": LONG, "files": ["*"]}).resolve(folder),
        lambda folder: load_bundle(folder / LONG),
        lambda folder: load_config(folder / LONG),
        lambda folder: load_scenario(folder / LONG),
        lambda folder: read_description(folder / LONG),
        lambda folder: read_steady_table(folder / LONG),
    ],
)
def test_a_name_that_is_too_long_is_a_missing_file(tmp_path, opened):
    with pytest.raises(NarxcalError, match="does not exist"):
        opened(tmp_path)
