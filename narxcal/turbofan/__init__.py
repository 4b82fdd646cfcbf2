"""A component-level twin-spool turbofan with its control: flights with known truth."""

from narxcal.turbofan.maker import maker_model
from narxcal.turbofan.unmodelled import Unmodelled
from narxcal.turbofan.virtual_engine import VirtualEngine, build_scatter

__all__ = ["Unmodelled", "VirtualEngine", "build_scatter", "maker_model"]
