"""From goals and estimates to motor torques."""
