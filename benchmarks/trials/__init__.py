"""Common parts of the benchmarks of the controller: trials with simulated hands, and the page with the results."""
