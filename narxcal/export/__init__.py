"""Any steady-state model as an encapsulated thing: a table in a CSV file, or a compiled FMU."""

from narxcal.export.fmu import export_fmu
from narxcal.export.grid import Grid
from narxcal.export.plan import export_table
from narxcal.export.report import ExportOptions, ExportReport

__all__ = ["ExportOptions", "ExportReport", "Grid", "export_fmu", "export_table"]
