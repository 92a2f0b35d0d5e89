"""Simulated nodes on the CAN bus: the drives of each protocol, and the sensor node."""

from firmware_sim.nodes import cubemars
from firmware_sim.nodes.cia402 import bench as cia402_bench
from firmware_sim.nodes.mit import bench as mit_bench
from firmware_sim.nodes.moteus import bench as moteus_bench
from firmware_sim.nodes.odrive import bench as odrive_bench
from firmware_sim.nodes.protocol_spec import ProtocolSpec
from firmware_sim.nodes.robstride import bench as robstride_bench
from firmware_sim.nodes.robstride import mit_mode

PROTOCOL_SPECS: dict[str, ProtocolSpec] = {
    "cia402": cia402_bench.CIA402_SPEC,
    "cubemars": cubemars.CUBEMARS_SPEC,
    "mit": mit_bench.MIT_SPEC,
    "moteus": moteus_bench.MOTEUS_SPEC,
    "odrive": odrive_bench.ODRIVE_SPEC,
    "robstride": robstride_bench.ROBSTRIDE_SPEC,
    "robstride_mit": mit_mode.ROBSTRIDE_MIT_SPEC,
}
"""Specification of each drive protocol, by the name of the protocol in a hand file."""
