"""Use of a recorded run: re-execution, driving again, judgement by other limits, comparison."""
