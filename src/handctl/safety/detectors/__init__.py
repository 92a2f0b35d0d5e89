"""What is kept and computed over many ticks, so that a row of the fault table can be judged."""
