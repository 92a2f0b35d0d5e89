"""Modules that use the log of a run.

The modules can execute the controller of a run again, repeat the run on a hand, judge the run by
other safety limits, and compare two runs.
"""
