"""Programs of ``python -m firmware_sim``: a hand, drives on a bench, a bus."""
