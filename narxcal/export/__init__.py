"""Any steady-state model as an encapsulated thing: a table in a CSV file, or a compiled FMU."""

from narxcal.export.fmu import export_fmu
from narxcal.export.grid import Grid
from narxcal.export.report import ExportOptions, ExportReport
from narxcal.export.table import export_table

__all__ = ["ExportOptions", "ExportReport", "Grid", "export_fmu", "export_table"]
