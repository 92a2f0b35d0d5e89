"""Motor drives and load cells on CAN: frames, codecs, and a state machine for each protocol."""
