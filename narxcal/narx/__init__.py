"""The NARX network: its structure, its free run, and the compiled kernels behind it."""
