"""Uses of a recorded run: re-execution, repetition, judgement by other limits, comparison of two runs."""
