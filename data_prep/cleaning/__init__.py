"""What is wrong with a log by itself: spikes, stuck and implausible channels, copies."""
