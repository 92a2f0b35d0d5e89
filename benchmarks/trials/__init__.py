"""Common parts of the controller benchmarks: a trial on the simulated plant, and the page."""
