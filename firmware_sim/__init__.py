"""The simulator of a tendon-driven hand: drives, sensor node and mechanics, as a host sees them over CAN."""
