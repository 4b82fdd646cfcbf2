"""Lumped two-spool engine: how each output follows its steady-state value."""
