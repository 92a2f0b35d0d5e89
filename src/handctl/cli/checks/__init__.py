"""Commands that check files, the machine, buses and drives before a run."""
