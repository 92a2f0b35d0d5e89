"""What lies in the hand's reach, and what happens to it."""
