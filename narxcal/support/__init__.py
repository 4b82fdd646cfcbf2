"""What every room uses and that has nothing to do with engines.

Errors a user can cause, configuration tables, files written whole or not at all, Ctrl-C, arrays,
and the compiler.
"""
