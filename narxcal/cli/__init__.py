"""The command `narxcal`: what it takes, what it prints, how it ends."""

from narxcal.cli.app import main

__all__ = ["main"]
