"""What a run was worth: numbers against the simulator's truth, and the picture of a run."""
