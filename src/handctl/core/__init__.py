"""What a tick computes: the hand's model, estimation, law."""
