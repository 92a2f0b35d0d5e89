"""Recorder, topics, reader and recovery of MCAP logs.

Common robotics tools open these logs without conversion.
"""
