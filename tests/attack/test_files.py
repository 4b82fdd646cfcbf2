"""Files that would take the memory, another file or the process: one error each."""

import zipfile

import numpy as np
import pytest

from data_prep.binary_source import open_binary
from data_prep.workbook import sheet_text
from narxcal.support.errors import DataError

h5py = pytest.importorskip("h5py")
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


def test_a_complex_column_is_no_column_of_numbers(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["N1"], file["time"] = np.full(9, 1j), np.arange(9.0)
    assert open_binary(tmp_path / "log.h5", "").header == ("time",)
