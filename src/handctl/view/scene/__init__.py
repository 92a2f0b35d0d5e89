"""Content of the dashboard, computed from the topics of a run."""
