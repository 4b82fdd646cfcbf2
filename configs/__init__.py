"""Shipped configurations, one TOML file per data set."""
