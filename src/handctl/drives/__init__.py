"""Motor drives and load cells on CAN: their frames, and a state machine for each protocol."""
