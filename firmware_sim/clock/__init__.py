"""Time of the simulation: the shared clock, the pace of the simulation, and real-time priority."""
