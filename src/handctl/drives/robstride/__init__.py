"""RobStride motors: private protocol with 29-bit identifiers."""
