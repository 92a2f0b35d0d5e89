"""Motor controllers of the type moteus (mjbots), with the register protocol of moteus over CAN FD."""
