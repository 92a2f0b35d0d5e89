"""The paper's experiments, measured on the simulated hand."""
