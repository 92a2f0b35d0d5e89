"""Fault campaign.

The campaign injects all faults of the fault matrix into a simulated hand in lockstep.
"""
