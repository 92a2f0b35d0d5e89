"""The control loops as linear systems: designed, with their margins."""
