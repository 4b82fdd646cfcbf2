"""A component-level twin-spool turbofan with its control: flights with known truth."""

from narxcal.turbofan.unmodelled import Unmodelled
from narxcal.turbofan.virtual_engine import VirtualEngine, build_scatter, maker_model

__all__ = ["Unmodelled", "VirtualEngine", "build_scatter", "maker_model"]
