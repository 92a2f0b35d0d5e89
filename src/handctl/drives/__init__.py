"""Motor drives and load cells on CAN.

The modules define the frames of each protocol, and a state machine for each protocol.
"""
