"""Control law: from goals and estimates to motor torques."""
