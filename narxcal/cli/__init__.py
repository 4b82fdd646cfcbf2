"""The command `narxcal`: what it takes, what it prints, how it ends."""

from narxcal.cli.entry import main

__all__ = ["main"]
