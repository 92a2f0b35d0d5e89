"""Reports on a run: figures, pages, and numbers compared with the simulator's truth."""
