"""The gap between a simulator and flights: read in pairs, located, explained, written down."""
