"""The mechanics: links and contacts by MuJoCo, tendons and rotors of our own."""
