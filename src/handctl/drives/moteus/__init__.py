"""Motor controllers moteus (mjbots) with their register protocol over CAN FD."""
