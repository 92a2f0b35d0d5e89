"""Log of a run in the format MCAP: recorder, topics, reader, and recovery of a damaged log.

Common robotics tools open logs in the format MCAP without conversion.
"""
