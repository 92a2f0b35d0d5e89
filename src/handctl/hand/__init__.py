"""Model of a hand: description, kinematics, dynamics, tendons, and export as URDF and MJCF.

The functions have no side effects, except that some read hand files.
"""
