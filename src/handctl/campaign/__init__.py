"""Fault campaign.

The campaign injects all faults of the fault matrix into a simulated hand. The controller and the
simulated hand run in lockstep.
"""
