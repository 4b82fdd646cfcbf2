"""Lumped two-spool engine: how each output follows its steady-state value.

`rotors` has the equations and the free run, `heat` the metal, casing and clearances, `engine` the
parameters by name, slopes by them, and storage. `training.dynamics.lags` fits it and chooses its
form.
"""
