"""Model of a robot hand: description, kinematics, dynamics, tendons, and export as URDF and MJCF.

Some functions read hand files. Apart from this, no function has side effects.
"""
