"""Search for gains on an ensemble of simulated hands."""
