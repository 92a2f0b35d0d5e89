"""Control loops as linear systems: design and margins."""
