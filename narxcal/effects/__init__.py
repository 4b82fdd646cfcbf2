"""Unmodelled effects: what a real engine does and its simulator does not."""

from narxcal.effects.base import Effect, Parameter, Signals
from narxcal.effects.library import LIBRARY, candidates, effect
from narxcal.effects.running import Emulator, Flights, respond

__all__ = [
    "LIBRARY",
    "Effect",
    "Emulator",
    "Flights",
    "Parameter",
    "Signals",
    "candidates",
    "effect",
    "respond",
]
