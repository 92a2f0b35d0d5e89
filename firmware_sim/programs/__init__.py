"""Programs that ``python -m firmware_sim`` runs: a simulated hand, simulated drives on a bench, or a local bus."""
