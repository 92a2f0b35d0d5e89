"""Common parts of the benchmarks of the controller: trials on the simulated plant, and the page with the results."""
