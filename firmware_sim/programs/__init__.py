"""What ``python -m firmware_sim`` runs: a hand, drives on a bench, a bus."""
