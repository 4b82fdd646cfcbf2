"""A component-level twin-spool turbofan with its control: flights with known truth."""

from narxcal.turbofan.engine import VirtualEngine, build_scatter, maker_model
from narxcal.turbofan.unmodelled import Unmodelled

__all__ = ["Unmodelled", "VirtualEngine", "build_scatter", "maker_model"]
