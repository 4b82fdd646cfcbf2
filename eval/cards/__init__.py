"""The next flight: which moves tell most, as a card that a pilot can fly."""
