"""Commands that run a real or a simulated hand."""
