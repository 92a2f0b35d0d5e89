"""Control loops as linear systems: design of their gains, and margins."""
