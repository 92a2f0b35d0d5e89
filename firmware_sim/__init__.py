"""The simulator of a tendon-driven hand.

The simulator computes the drives, the sensor node and the mechanics. A host communicates with the
simulated nodes over CAN.
"""
