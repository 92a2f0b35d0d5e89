"""Model of a robot hand: description, kinematics, dynamics, tendons, and export as URDF and MJCF.

Some functions read hand files. No function has other side effects.
"""
