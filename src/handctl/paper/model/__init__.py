"""The paper's equations and numbers, each checked against the correct ones."""
