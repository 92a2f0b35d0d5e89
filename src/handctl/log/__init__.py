"""Log of a run in the MCAP format: recorder, topics, reader, and recovery of a damaged log.

Common robotics tools open these logs without conversion.
"""
