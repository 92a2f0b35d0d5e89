"""The simulator of a tendon-driven hand: its drives, sensor node and mechanics, as a host sees them over CAN."""
