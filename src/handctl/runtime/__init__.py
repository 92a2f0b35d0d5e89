"""Runtime: clocks, buses, the fixed-rate loop, and requests of other processes."""
