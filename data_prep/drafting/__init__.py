"""A draft of the configuration from files that nobody has described: names, units, engines."""
