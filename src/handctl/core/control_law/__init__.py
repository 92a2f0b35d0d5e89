"""Control law: computation of motor torques from goals and estimates."""
