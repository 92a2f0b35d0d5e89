"""Model of a robot hand: description, kinematics, dynamics, tendons, and export as URDF and MJCF.

Some functions of this package read hand files. The functions have no other side effects.
"""
