"""Content of the dashboard that the viewer Rerun shows.

The content is computed from the topics of a log.
"""
