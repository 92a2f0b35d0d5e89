"""Recorder, topics, reader and recovery of MCAP logs.

Common robotics tools open the logs as they are.
"""
