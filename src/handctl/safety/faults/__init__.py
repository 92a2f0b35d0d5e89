"""The fault table: every fault declared, by where it comes from."""
