"""What a hand is: description, kinematics, dynamics, tendons, URDF; pure, but for reading hand files."""
