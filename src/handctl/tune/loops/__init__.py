"""Control loops as linear systems: the design of their gains, and their margins."""
