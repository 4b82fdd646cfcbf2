"""Steady-state models: where an engine settles, as a table, a fit, a function or an FMU."""
