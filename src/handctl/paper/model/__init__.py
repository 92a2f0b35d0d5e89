"""The paper's equations and numbers, each compared with the correct equation or number."""
