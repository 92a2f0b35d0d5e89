"""What the benchmarks of the controller share: a trial against the simulator's plant, and the page they write."""
