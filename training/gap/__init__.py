"""Which unmodelled effect causes the gap between simulation and flight."""
