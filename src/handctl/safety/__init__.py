"""Safety of the hand: declarations of faults, reactions and thresholds, and the choice of the reaction."""
