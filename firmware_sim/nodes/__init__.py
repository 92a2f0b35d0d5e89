"""Simulated nodes on the CAN bus: the drives of each protocol, and the sensor node."""

from firmware_sim.nodes import cubemars
from firmware_sim.nodes.cia402 import bench as cia402_bench
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.nodes.moteus import bench as moteus_bench
from firmware_sim.nodes.odrive import bench as odrive_bench
from firmware_sim.nodes.protocol_spec import ProtocolSpec
from firmware_sim.nodes.robstride import bench as robstride_bench
from firmware_sim.nodes.robstride import mit_mode

PROTOCOLS: dict[str, ProtocolSpec] = {
    "cia402": cia402_bench.SPEC,
    "cubemars": cubemars.SPEC,
    "mit": mit_bench.SPEC,
    "moteus": moteus_bench.SPEC,
    "odrive": odrive_bench.SPEC,
    "robstride": robstride_bench.SPEC,
    "robstride_mit": mit_mode.SPEC,
}
"""Specification of each drive protocol, by the name of the protocol in a hand file."""
