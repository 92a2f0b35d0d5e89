"""Control loops as linear systems, with the design of their gains and their stability margins."""
