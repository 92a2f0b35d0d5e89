"""What sits on the bus: one module per drive protocol, and the sensor node."""

from firmware_sim.nodes import cubemars
from firmware_sim.nodes.cia402 import bench as cia402_bench
from firmware_sim.nodes.kind import Kind
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.nodes.odrive import bench as odrive_bench

PROTOCOLS: dict[str, Kind] = {
    "cia402": cia402_bench.KIND,
    "cubemars": cubemars.KIND,
    "mit": mit_bench.KIND,
    "odrive": odrive_bench.KIND,
}
"""Name in the hand file, and what speaks it."""
