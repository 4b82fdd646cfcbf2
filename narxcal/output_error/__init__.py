"""Grey-box engine with its controls, after the Spey paper (DeHoff et al.).

`blocks` are linear systems, play and governor, each usable alone; `engine` chains them from
measured inputs to measured outputs, with a table of named parameters; `paper` has the paper's
tables as data and simulates its flight records. Estimation is in `training.papers.output_error`.
"""
