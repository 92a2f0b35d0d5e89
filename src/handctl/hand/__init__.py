"""Hand: description, kinematics, dynamics, tendons, URDF and MJCF. Pure, except for reading hand files."""
