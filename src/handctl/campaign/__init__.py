"""The whole fault matrix against a simulated hand in lockstep: felt, reacted to, in time."""
