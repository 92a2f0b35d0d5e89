"""The controller of a hand, as pure functions: tick, modes, state, requests, change of gains, shutdown."""
