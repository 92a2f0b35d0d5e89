"""Program that computes the meshes of packaged hands from a few dimensions."""
