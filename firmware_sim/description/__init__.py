"""Description of the simulated hand: the hand file, the MuJoCo model that is built from it, and its meshes."""
