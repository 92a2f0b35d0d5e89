"""Reports on a run: figures, pages, and numbers that compare the run with the true values of the simulator."""
