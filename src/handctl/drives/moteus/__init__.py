"""Moteus controllers (mjbots): register protocol over CAN FD."""
