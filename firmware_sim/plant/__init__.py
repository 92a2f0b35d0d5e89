"""The mechanics: links and contacts by MuJoCo, tendons and rotors by this package."""
