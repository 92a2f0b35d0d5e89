"""The search for gains on an ensemble of simulated hands."""
