"""Motors with the MIT protocol: Damiao motors and CubeMars motors.

The feedback of CubeMars motors contains less data.
"""
