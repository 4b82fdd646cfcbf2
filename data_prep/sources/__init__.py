"""Files of any recorder as columns on one uniform grid, read in bounded memory.

`log_file` opens a file; columns, units and stamps are understood once, whatever the format.
"""
