"""Content of the dashboard in the viewer. The content is computed from the topics of a log."""
