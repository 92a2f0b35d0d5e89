"""What sits on the bus: one module per drive protocol, and the sensor node."""

from firmware_sim.nodes import cia402_bench, cubemars, mit_bench, odrive_bench
from firmware_sim.nodes.kind import Kind

PROTOCOLS: dict[str, Kind] = {
    "cia402": cia402_bench.KIND,
    "cubemars": cubemars.KIND,
    "mit": mit_bench.KIND,
    "odrive": odrive_bench.KIND,
}
"""Name in the hand file, and what speaks it."""
