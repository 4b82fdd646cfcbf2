"""The diagnosis as a budget: a sum of single effects over learned or assumed discrepancy."""
