"""The pure controller: Controller: tick, modes, state, requests, change of gains, and shutdown."""
