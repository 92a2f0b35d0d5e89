"""Reports on a run: figures, pages, and numbers against the simulator's truth."""
