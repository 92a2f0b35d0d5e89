"""Content of the dashboard, and its derivation from the topics of a run."""
