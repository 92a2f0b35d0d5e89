"""The controller of a hand, as functions without side effects: tick, modes, state, requests, change of gains, and shutdown."""
