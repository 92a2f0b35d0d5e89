"""The simulator of a tendon-driven hand.

It simulates the drives, the sensor node and the mechanics. A host communicates with them over CAN.
"""
