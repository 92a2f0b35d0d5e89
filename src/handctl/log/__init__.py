"""The log room: recorder, topics, reader and recovery of MCAP files that common robotics tools just open."""
