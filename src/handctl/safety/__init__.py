"""Safety of the hand: the faults, the thresholds, the reactions, and the choice of the reaction to active faults."""
