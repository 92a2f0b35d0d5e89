"""Modules that use the log of a run.

The modules can execute the controller again, repeat the run on a hand, judge the run by other
limits, and compare two runs.
"""
