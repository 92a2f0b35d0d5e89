"""Log of a run in the format MCAP: recorder, topics, reader, and recovery of a damaged log.

Common robotics tools open these logs without conversion.
"""
