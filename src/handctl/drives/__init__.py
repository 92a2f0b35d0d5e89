"""Motor drives and load cells on CAN.

The modules define the frames and the state machine of each drive protocol.
"""
