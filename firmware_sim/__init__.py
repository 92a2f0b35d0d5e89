"""Simulated drives, sensor node and mechanics of a tendon-driven hand, on the other side of the CAN bus."""
