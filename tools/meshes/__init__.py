"""Compute the meshes of packaged hands from a few dimensions."""
