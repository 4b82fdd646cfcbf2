"""Files that would take the memory, another file or the process: one error each."""

import zipfile

import pytest

from data_prep.sources.binary_source import open_binary
from data_prep.sources.workbook import sheet_text
from eval.fleets import fleet
from narxcal.support.addresses import Folder
from narxcal.support.errors import ConfigError, DataError

h5py = pytest.importorskip("h5py")
pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")
pytest.importorskip("python_calamine")

_OFFICE = "http://schemas.openxmlformats.org/"
_RELATIONS = f"{_OFFICE}officeDocument/2006/relationships"
_PACKAGE = f'<Relationships xmlns="{_OFFICE}package/2006/relationships">'
PARTS = {
    "[Content_Types].xml": f'<Types xmlns="{_OFFICE}package/2006/content-types"/>',
    "_rels/.rels": f'{_PACKAGE}<Relationship Id="r1" Type="{_RELATIONS}/officeDocument" '
    'Target="xl/workbook.xml"/></Relationships>',
    "xl/workbook.xml": f'<workbook xmlns="{_OFFICE}spreadsheetml/2006/main" '
    f'xmlns:r="{_RELATIONS}"><sheets><sheet name="a" sheetId="1" r:id="r1"/></sheets></workbook>',
    "xl/_rels/workbook.xml.rels": f'{_PACKAGE}<Relationship Id="r1" Type="{_RELATIONS}/worksheet" '
    'Target="worksheets/sheet1.xml"/></Relationships>',
}


def workbook(path, *places):
    rows = "".join(f'<row><c r="{place}"><v>1</v></c></row>' for place in places)
    sheet = f'<worksheet xmlns="{_OFFICE}spreadsheetml/2006/main"><sheetData>{rows}</sheetData>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in {**PARTS, "xl/worksheets/sheet1.xml": f"{sheet}</worksheet>"}.items():
            archive.writestr(name, text)
    return path


def test_a_workbook_of_two_cells_that_spans_a_sheet_is_refused(tmp_path):
    path = workbook(tmp_path / "log.xlsx", "A1", "XFD1048576")
    with pytest.raises(DataError) as error:
        sheet_text(path)
    assert str(error.value) == (
        f"{path}: 2 cells span 1048576 rows and 16384 columns. "
        "Delete the cells that stand far from the table, or save it as CSV"
    )
    assert sheet_text(workbook(path, "A1", "B2")).read() == "1.0\t\n\t1.0\n"


def external_storage(file):
    file.create_dataset("N1", (8,), "f8", external=[("/etc/passwd", 0, 64)])


def external_link(file):
    file["N1"] = h5py.ExternalLink("/etc/passwd", "/N1")


def virtual(file):
    layout = h5py.VirtualLayout((8,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "N1", (8,))
    file.create_virtual_dataset("N1", layout)


def unwritten(file):
    for name in ("N1", "N2", "N3"):
        file.create_dataset(name, (6_000_000,), "f8", chunks=(1000,))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (external_storage, "its samples are in another file. Copy them into this one"),
        (external_link, "its samples are in another file. Copy them into this one"),
        (virtual, "its samples are in another file. Copy them into this one"),
        (unwritten, "say that they hold arrays of more than"),
    ],
)
def test_hdf5_reads_its_own_samples_alone(tmp_path, make, words):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        make(file)
    with pytest.raises(DataError) as error:
        open_binary(tmp_path / "log.h5", "")
    assert words in str(error.value)


ROW = {"tail": "N1", "batch": 0, "file": "N1/a.csv", "size": 9, "sha256": "", "engine": ""}


def list_of(folder, row, **columns):
    """A work list of one row in a folder; `columns` change types."""
    kinds = {"batch": pa.int64(), "size": pa.int64(), **columns}
    schema = pa.schema([(name, kinds.get(name, pa.string())) for name in row])
    parquet.write_table(pa.Table.from_pylist([row], schema), folder / fleet.WORK_LIST)


@pytest.mark.parametrize(
    ("row", "columns", "problem"),
    [
        ({"file": "../secret.csv"}, {}, "expected a tail and a file below the folder of flights, "),
        ({"file": "/etc/passwd"}, {}, "expected a tail and a file below the folder of flights, "),
        ({"file": "C:/secret.csv"}, {}, "expected a tail and a file below the folder of flights, "),
        ({"tail": ""}, {}, "expected a tail and a file below the folder of flights, "),
        ({"size": None}, {}, "its size is missing. "),
        ({"tail": None}, {}, "its tail is missing. "),
        ({"batch": -1}, {}, "expected a batch and a size of at least 0. "),
        ({}, {"batch": pa.string()}, "expected a column of int64, found string. "),
        ({"engine": 1}, {"engine": pa.int64()}, "expected a column of string, found int64. "),
    ],
)
def test_a_planted_work_list_is_refused(tmp_path, row, columns, problem):
    planted = ROW | row
    if columns.get("batch"):
        planted["batch"] = "0"
    list_of(tmp_path, planted, **columns)
    with pytest.raises(DataError) as error:
        fleet.read_table(Folder(str(tmp_path)), fleet.WORK_LIST)
    assert problem in str(error.value)


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"schema": "narxcal.fleet-dataset/1", "runs": 1, "versions": {}}', "[" * 9999],
)
def test_a_damaged_document_of_a_dataset_is_refused(tmp_path, text):
    (tmp_path / fleet.DOCUMENT).write_text(text)
    with pytest.raises(DataError, match=r"fleet\.json"):
        fleet.read_document(Folder(str(tmp_path)))


@pytest.mark.parametrize(
    "address", ["ftp://127.0.0.1/x", "http://127.0.0.1/x", "simplecache::s3://x"]
)
def test_other_addresses_are_refused_before_anything_connects(address):
    with pytest.raises(ConfigError, match="expected a path or an address of abfs, az, gcs, "):
        Folder(address).has("x")


def test_a_pattern_that_searches_for_ever_is_ended(monkeypatch):
    monkeypatch.setattr(fleet, "_SEARCH_S", 1.0)
    config = fleet.FleetConfig(flights="flights", run="run", tail="(a+)+b")
    with pytest.raises(ConfigError, match=r"tail = '\(a\+\)\+b' finds nothing within 1 s"):
        config.tails_of(["a" * 64])
    assert config.tails_of(["aab"]) == {"aab": "aa"}
