"""Meshes of packaged hands, which are computed from a few numbers."""
