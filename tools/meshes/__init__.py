"""Meshes of packaged hands, made from a few numbers."""
