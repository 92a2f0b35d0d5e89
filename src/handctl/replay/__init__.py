"""Uses of a recorded run: re-execution, repetition of the motion, judgement by other limits, comparison of two runs."""
