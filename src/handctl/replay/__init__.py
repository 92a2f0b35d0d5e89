"""Uses of a recorded run: execute it again, repeat its motion, judge it by other limits, compare two runs."""
