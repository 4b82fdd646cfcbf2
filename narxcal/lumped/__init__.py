"""Lumped two-spool engine: how each output follows its steady-state value.

`limited` and `governed` have the equations of its two forms, `states` what they share, `heat` the
metal, casing and clearances, `engine` the parameters by name, the free run, slopes, and storage.
`training.dynamics.lags` fits it and chooses its form.
"""
