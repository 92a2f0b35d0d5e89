"""Content of the dashboard in the viewer, computed from the topics of a log."""
