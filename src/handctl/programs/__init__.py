"""Programs, which set the goals of all digits in every tick."""
