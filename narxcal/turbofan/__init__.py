"""A component-level twin-spool turbofan with its control: flights with known truth."""

from narxcal.turbofan.engine import Unmodelled, VirtualEngine, build_scatter, maker_model

__all__ = ["Unmodelled", "VirtualEngine", "build_scatter", "maker_model"]
